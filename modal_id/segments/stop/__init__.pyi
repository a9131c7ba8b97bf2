from .change_point import driven_then_free as driven_then_free
from .change_point import running_rss as running_rss
from .instant import Stop as Stop
from .instant import locate_stop as locate_stop
