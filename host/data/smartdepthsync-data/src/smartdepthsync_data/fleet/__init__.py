"""Extraction of every recording of a store, on Ray: see :func:`fleet`."""

from .run import fleet

__all__ = ["fleet"]
