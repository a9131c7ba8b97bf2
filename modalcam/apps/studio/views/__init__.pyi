from .page import build_page as build_page
from .page import build_pick_page as build_pick_page
