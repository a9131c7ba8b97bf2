from .build import Plots as Plots
from .build import build_report as build_report
from .build import report_terms as report_terms
from .drawing import draw_figures as draw_figures
from .figure_files import write_figures as write_figures
