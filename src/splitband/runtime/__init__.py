"""Provide atomic files, processes, threads and deadlines."""
