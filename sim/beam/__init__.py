"""The ANCF beam: properties, elements, equilibrium, modes."""
