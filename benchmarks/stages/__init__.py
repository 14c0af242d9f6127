"""Runs that several benchmarks share: learned norms, aligned agents, agents from preferences."""
