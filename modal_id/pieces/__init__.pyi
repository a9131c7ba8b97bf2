from .fit_decays import DecayFits as DecayFits
from .fit_decays import fit_decays as fit_decays
from .fit_decays import mean_scatter_rad_s as mean_scatter_rad_s
from .fit_pieces import click_segments as click_segments
from .fit_pieces import misfit as misfit
from .fit_pieces import without_clicks as without_clicks
