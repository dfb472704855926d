from __future__ import annotations

from spool_core.node import testing

#: Fixtures that every package's tests of nodes have.
away_from_other_ros_programs = testing.away_from_other_ros_programs
claim_domain, domain_id = testing.claim_domain, testing.domain_id
