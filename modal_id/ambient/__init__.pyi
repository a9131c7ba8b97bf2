from .ambient import identify_ambient as identify_ambient
from .ambient import log_sds as log_sds
from .order import misfit_of as misfit_of
from .spectrum import transfer as transfer
