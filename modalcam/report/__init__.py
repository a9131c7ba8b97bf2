"""One self-contained HTML page from what a run found: no script, no request, same input, same bytes."""
