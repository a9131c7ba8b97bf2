"""Programs built on the core with its public names; each registers its commands, stages and sections as a plugin does."""
