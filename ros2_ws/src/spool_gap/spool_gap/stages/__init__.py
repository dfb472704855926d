"""Stages of the selection: one file each, in the lists that ``workflow.analyse`` and ``growth`` hold."""
