"""HTML pages, each one self-contained file; the report of a run."""
