from .cli import compare as compare
from .compare import compare_runs as compare_runs
from .compare import page as page
