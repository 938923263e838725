"""The commands that train, clone, export and evaluate policies: `spatula NAME`, and `python -m agents.NAME`."""
