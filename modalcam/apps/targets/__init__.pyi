from .cli import calibrate as calibrate
from .cli import markers as markers
from .targets import aruco_pages as aruco_pages
from .targets import board_page as board_page
from .targets import calibrate_folder as calibrate_folder
from .targets import dot_pages as dot_pages
from .targets import parse_ids as parse_ids
from .targets import save_pages as save_pages
