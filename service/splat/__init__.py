"""The CPU splatter: renders 3D Gaussians to colour, opacity and depth; numba kernels and a float64 reference."""

from .definition import INRIA as INRIA
from .definition import Definition as Definition
from .leverage import Leverage as Leverage
from .leverage import Planes as Planes
from .leverage import leverage as leverage
from .reference import render_reference as render_reference
from .render import Render as Render
from .render import render as render
from .render import render_views as render_views
from .supersample import render_supersampled as render_supersampled
