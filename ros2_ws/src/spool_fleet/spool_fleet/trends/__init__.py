"""Trends: what changed from bag to bag, corrected for temperature and compared with sister valves."""
