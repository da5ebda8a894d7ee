"""gapmes.service.pictures: renders as files: pictures, films, contact sheets, and how wrong they are."""
