"""RAFT: measured optical flow from published weights. See `network.Raft`."""

from .network import Features, Raft

__all__ = ["Features", "Raft"]
