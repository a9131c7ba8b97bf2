"""How the numbers came about, with the sources, in words that a paper can take over."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reference:
    """A source; `doi` is empty where it has none."""

    key: str
    text: str
    doi: str = ""


REFERENCES = (
    Reference(
        "yoo", "Yoo, W.-S., Lee, J.-W., Kim, H.-W.: Tracking for high-order damping of thin beam oscillation."
    ),
    Reference(
        "varpro",
        "Golub, G. H., Pereyra, V.: The differentiation of pseudo-inverses and nonlinear least squares problems whose "
        "variables separate. SIAM Journal on Numerical Analysis 10 (1973) 413–432.",
        "10.1137/0710036",
    ),
    Reference(
        "emcee",
        "Foreman-Mackey, D., Hogg, D. W., Lang, D., Goodman, J.: emcee: the MCMC hammer. Publications of the "
        "Astronomical Society of the Pacific 125 (2013) 306–312.",
        "10.1086/670067",
    ),
    Reference(
        "rhat",
        "Vehtari, A., Gelman, A., Simpson, D., Carpenter, B., Bürkner, P.-C.: Rank-normalization, folding, and "
        "localization: an improved R̂ for assessing convergence of MCMC. Bayesian Analysis 16 (2021) 667–718.",
        "10.1214/20-BA1221",
    ),
    Reference(
        "ancf",
        "Berzeri, M., Shabana, A. A.: Development of simple models for the elastic forces in the absolute nodal "
        "co-ordinate formulation. Journal of Sound and Vibration 235 (2000) 539–565.",
        "10.1006/jsvi.1999.2935",
    ),
    Reference(
        "momentum",
        "Simo, J. C., Tarnow, N.: The discrete energy-momentum method. Conserving algorithms for nonlinear "
        "elastodynamics. Zeitschrift für angewandte Mathematik und Physik 43 (1992) 757–792.",
        "10.1007/BF00913408",
    ),
    Reference(
        "scores",
        "Gneiting, T., Raftery, A. E.: Strictly proper scoring rules, prediction, and estimation. Journal of the "
        "American Statistical Association 102 (2007) 359–378.",
        "10.1198/016214506000001437",
    ),
    Reference(
        "hac",
        "Newey, W. K., West, K. D.: A simple, positive semi-definite, heteroskedasticity and autocorrelation "
        "consistent covariance matrix. Econometrica 55 (1987) 703–708.",
        "10.2307/1913610",
    ),
)


@dataclass(frozen=True)
class Paragraph:
    """A paragraph on one stage and the keys of its sources."""

    title: str
    text: str
    sources: tuple[str, ...] = ()


_TRACKING = Paragraph(
    "Tracking",
    "Each marker is found once and then followed: a template is registered to the untouched pixels of every frame by "
    "weighted least squares, with gain and offset, in a window predicted from the motion so far. The "
    "standard deviation "
    "of each position comes from the information matrix of that fit. Frames in which a marker is missing stay missing; "
    "nothing is filled in.",
)
_IDENTIFICATION = Paragraph(
    "Identification",
    "From the onset on, the record is modelled as a sum of free decays, Eq. 1 of [yoo], with one natural frequency and "
    "one damping ratio per mode shared by all markers, and a slow baseline. Amplitudes and baseline enter linearly and "
    "are eliminated [varpro]; the sum of squares of Eq. 2 is minimised over the rest. What is called frequency is "
    "ωₙ / 2π, undamped.",
    ("yoo", "varpro"),
)
_POSTERIOR = Paragraph(
    "Uncertainty",
    "The posterior of frequency and damping ratio, amplitudes and noise level marginalised, is sampled by emcee "
    "[emcee] with several independent ensembles; R̂ is taken over ensembles, never over walkers [rhat]. The standard "
    "deviation of white noise is multiplied by the level of the residual's spectrum near the mode (the noise factor), "
    "and widened where damping depends on amplitude. Intervals are central 90 % intervals unless "
    "another level is named.",
    ("emcee", "rhat"),
)
_SIMULATION = Paragraph(
    "Simulation",
    "The beam is a planar beam of the absolute nodal coordinate formulation [ancf] under gravity, stepped by an "
    "energy-momentum scheme [momentum]. Rayleigh damping (Eq. 3, 4 of [yoo]) takes α and β from the "
    "two lowest measured "
    "modes. Generic damping is M Φ diag(2 ζᵣ ωᵣ) Φᵀ M over the measured modes (Eq. 5, 6 of [yoo]). Both start from the "
    "state fitted at the start of the decay; frequency and damping ratio are identified from the "
    "simulated decays by the "
    "code that identified the measured ones. The error of a simulated decay is the rms of its difference from the "
    "measured one over the rms of the measured one (nrmse). Bands come from simulations with draws from the "
    "posteriors of all modes and of the updated beam. Models are scored by the log predictive density and the "
    "continuous ranked probability score of every sample [scores]; the standard error of a difference "
    "takes the noise of neighbouring "
    "periods as correlated [hac]. Where the damping ratio rises with the amplitude, quadratic drag of the air is "
    "fitted by simulation.",
    ("yoo", "ancf", "momentum", "scores", "hac"),
)


def paragraphs(*, simulated: bool) -> tuple[Paragraph, ...]:
    """What was done, stage by stage."""
    always = (_TRACKING, _IDENTIFICATION, _POSTERIOR)
    return (*always, _SIMULATION) if simulated else always


def numbered(text: str, sources: tuple[Reference, ...]) -> str:
    """Text with keys in brackets replaced by the numbers of the sources."""
    for index, source in enumerate(sources, start=1):
        text = text.replace(f"[{source.key}]", f"[{index}]")
    return text


def cited(parts: tuple[Paragraph, ...]) -> tuple[Reference, ...]:
    """Sources of these paragraphs, in the order of `REFERENCES`."""
    keys = {key for part in parts for key in part.sources}
    return tuple(reference for reference in REFERENCES if reference.key in keys)
