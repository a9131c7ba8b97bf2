"""Scripts that compute pages of the documentation, and the reference solutions that they share with the tests."""
