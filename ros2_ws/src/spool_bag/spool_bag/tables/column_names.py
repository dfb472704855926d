"""Column names of records in tables: their quantity and unit in one."""

from __future__ import annotations

TIME = "time_s"
BODY = "body_m_s2"
SPOOL = "spool_m_s2"
OIL_TEMPERATURE = "oil_temperature_C"
DISPLACEMENT = "displacement_m"
FORCE = "force_N"
