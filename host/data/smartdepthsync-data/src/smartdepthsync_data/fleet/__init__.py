"""Every recording of a store extracted, on Ray: see :func:`fleet`."""

from .run import fleet

__all__ = ["fleet"]
