from .fit_decays import fit_decays as fit_decays
from .misfit import misfit as misfit
from .spread import mean_scatter_rad_s as mean_scatter_rad_s
