"""Live checks: what the running nodes say of themselves, and how near this machine is to its limits."""
