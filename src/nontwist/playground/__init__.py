"""A page on which two bodies can be kicked, integrated live in the browser."""

from .page import playground

__all__ = ["playground"]
