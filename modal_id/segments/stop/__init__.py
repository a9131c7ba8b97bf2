"""The instant at which steady shaking ends and a free decay begins."""
