"""Settings of the middleware for many nodes in a process: what is allocated ahead for each end point.

Fast DDS allocates 100 samples for each of the 30 end points of a node before the first one is sent: 1 MB of
2.3 MB that a managed node takes. A profile changes that (Fast DDS, "XML profiles", ``allocated_samples``).
"""

from __future__ import annotations

import atexit
import os
import tempfile
from pathlib import Path

PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com">
 <profiles>
  <data_writer profile_name="spool_writer" is_default_profile="true">
   <topic><resourceLimitsQos><allocated_samples>1</allocated_samples></resourceLimitsQos></topic>
   <historyMemoryPolicy>DYNAMIC_REUSABLE</historyMemoryPolicy>
  </data_writer>
  <data_reader profile_name="spool_reader" is_default_profile="true">
   <topic><resourceLimitsQos><allocated_samples>1</allocated_samples></resourceLimitsQos></topic>
   <historyMemoryPolicy>DYNAMIC_REUSABLE</historyMemoryPolicy>
  </data_reader>
 </profiles>
</dds>
"""
FILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")


def economise() -> None:
    """Let the middleware of this process allocate little ahead; a profile that the user has given stands."""
    if any(name in os.environ for name in FILES):
        return
    with tempfile.NamedTemporaryFile("w", prefix="spool_", suffix=".xml", delete=False) as stream:
        stream.write(PROFILE)
    path = Path(stream.name)
    atexit.register(path.unlink, missing_ok=True)  # processes that are forked end without it
    for name in FILES:
        os.environ[name] = str(path)
    os.environ["RMW_FASTRTPS_USE_QOS_FROM_XML"] = "1"
