"""Trained agents as ONNX files, `agent`, and arms as chains in MuJoCo, `mujoco_chain`: each needs
the libraries of its own extra alone."""
