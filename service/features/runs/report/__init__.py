"""Reports of runs: what a report says, and the files that say it."""
