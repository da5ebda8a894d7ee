"""gapmes.service.http: the routes, the problem documents and the bounds of the HTTP service."""
