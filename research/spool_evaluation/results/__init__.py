"""Results of studies and benchmarks: proportions with intervals, timings, dated pages."""
