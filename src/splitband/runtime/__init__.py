"""What everything runs on: files that are never half written, processes, threads."""
