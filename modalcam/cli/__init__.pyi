from .app import app as app
from .app import main as main
from .options import CONFIG_HELP as CONFIG_HELP
from .options import results_folder as results_folder
