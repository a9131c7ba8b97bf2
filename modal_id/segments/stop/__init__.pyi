from .change_point import ChangeSearch as ChangeSearch
from .change_point import driven_then_free as driven_then_free
from .instant import Stop as Stop
from .instant import locate_stop as locate_stop
