"""Figures of the report, one theme a file; each function draws one and returns it with its caption."""
