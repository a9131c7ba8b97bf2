"""The function that this app adds to `modalcam`."""

from modalcam.plugins import register_function

register_function("plan", "modalcam.apps.plan.plan")
