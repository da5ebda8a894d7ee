"""gapmes.service.mending: what is done with the network's Gaussians: depths, backdrop, opacities, colours, detail."""
