"""Demonstration: live nodes, their recording and its report."""
