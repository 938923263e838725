"""How the cost of what users do grows with size; run with `python -m benchmarks.growth`."""
