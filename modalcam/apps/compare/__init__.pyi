from .cli import compare as compare
from .compare import compare_runs as compare_runs
from .page import page as page
