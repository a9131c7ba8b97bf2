from . import reference as reference
from .reference import MEASURED_DAMPING_RATIO as MEASURED_DAMPING_RATIO
from .reference import MEASURED_FREQUENCY_HZ as MEASURED_FREQUENCY_HZ
from .reference import paper_beam as paper_beam
from .reference import sample_beam as sample_beam
from .reference import tapered_beam as tapered_beam
