"""Short runs of emcee, for tests that do not check the posterior itself."""

from modal_id import SamplerSettings

# A fifth of the default's steps: medians within 0.03 standard deviations, intervals within 5 % of their width.
QUICK = SamplerSettings(check_steps=20, autocorrelation_times=10.0)
