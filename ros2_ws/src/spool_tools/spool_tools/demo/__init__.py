"""The demonstration: live nodes, their recording and its report."""
