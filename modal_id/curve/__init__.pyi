from .average import amplitude_curve as amplitude_curve
from .average import explains as explains
from .law_fit import decay_of_law as decay_of_law
from .law_fit import wave_of_law as wave_of_law
from .laws import PowerLaw as PowerLaw
from .laws import SaturatingLaw as SaturatingLaw
from .laws import SplineLaw as SplineLaw
from .track import LEAST_CYCLES as LEAST_CYCLES
