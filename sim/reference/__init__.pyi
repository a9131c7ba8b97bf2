from . import paper_tables as paper_tables
from .paper_beam import MEASURED_DAMPING_RATIO as MEASURED_DAMPING_RATIO
from .paper_beam import MEASURED_FREQUENCY_HZ as MEASURED_FREQUENCY_HZ
from .paper_beam import paper_beam as paper_beam
from .paper_beam import sample_beam as sample_beam
from .paper_beam import tapered_beam as tapered_beam
