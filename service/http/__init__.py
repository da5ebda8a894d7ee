"""gapmes.service.http: routes, middleware, problem documents and limits of the HTTP service."""
