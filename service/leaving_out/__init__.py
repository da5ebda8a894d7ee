"""gapmes.service.leaving_out: pruning of Gaussians within a proved bound on the change of colour."""
