"""The output folder and the results saved in it."""
