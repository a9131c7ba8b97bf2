from .average import amplitude_curve as amplitude_curve
from .laws import PowerLaw as PowerLaw
from .laws import SaturatingLaw as SaturatingLaw
from .laws import SplineLaw as SplineLaw
from .quadrature import decay_of_law as decay_of_law
from .quadrature import wave_of_law as wave_of_law
