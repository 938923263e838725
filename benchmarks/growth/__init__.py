"""How what users do grows with the size of what they do it with; `python -m benchmarks.growth`."""
