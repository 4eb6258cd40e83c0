"""The numerical part of the paper: its three cases, six tables and four figures a case (sec-results)."""

from .tables import Reproduction, reproduce

__all__ = ["Reproduction", "reproduce"]
