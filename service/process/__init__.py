"""gapmes.service.process: the process and its machine: memory, threads, signals, streams, files and locks."""
