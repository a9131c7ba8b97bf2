from .compare import compare_runs as compare_runs
from .page import FILES as FILES
from .page import page as page
from .page import show as show
from .page import write_files as write_files
