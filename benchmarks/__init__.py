"""Measurements of speed and quality. Each module runs as `python -m benchmarks.NAME` and ends with one JSON line."""
