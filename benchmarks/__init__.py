"""What is measured: one module for each benchmark, and their results."""
