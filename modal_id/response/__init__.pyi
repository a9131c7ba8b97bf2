from .columns import Samples as Samples
from .columns import drive as drive
from .identify_response import identify_response as identify_response
from .known_input import fit_response as fit_response
from .other_clock import at_other_times as at_other_times
from .solution import ResponseFit as ResponseFit
from .solution import local_polynomial as local_polynomial
