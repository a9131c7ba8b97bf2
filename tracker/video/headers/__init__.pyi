from .camera_header import HEADER_SUFFIXES as HEADER_SUFFIXES
from .camera_header import companion as companion
from .camera_header import with_companion as with_companion
from .camera_header import with_header as with_header
from .camera_header import with_header_beside as with_header_beside
from .camera_header import without_header as without_header
from .photron_header import PhotronHeader as PhotronHeader
from .photron_header import read_photron_header as read_photron_header
