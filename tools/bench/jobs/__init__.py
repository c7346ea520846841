"""What measures: functions that `tools.bench.child` runs in a new process, one at a time."""
