"""Trained agents as single ONNX files: measurements in SI units in, commands out; no simulator, and no framework of learning, is needed."""

from soft_tendon_env.export.agent import export_agent as export_agent
