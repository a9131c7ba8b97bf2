from .ambient import identify_ambient as identify_ambient
from .expected import transfer as transfer
from .law import log_sds as log_sds
from .order import misfit_of as misfit_of
