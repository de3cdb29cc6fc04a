"""Trained agents as single ONNX files: measurements in SI units in, commands out; no simulator, and no framework of learning, is needed."""

from soft_tendon_env.export.agent import export_agent
from soft_tendon_env.export.numpy_runner import Agent

__all__ = ["Agent", "export_agent"]
