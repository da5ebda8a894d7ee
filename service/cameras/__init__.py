"""gapmes.service.cameras: posed pinhole cameras, the files that hold them, and the checks of a set of them."""
