"""gapmes.service.network.backends: the runtimes that compute the network, each behind the same few calls."""
