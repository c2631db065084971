"""Provide files that are never half written, processes, threads and deadlines."""
