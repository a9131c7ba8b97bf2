"""Programs built on the core with its public names; each registers its commands as a plugin does."""
