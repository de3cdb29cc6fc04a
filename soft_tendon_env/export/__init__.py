"""Export of trained agents as ONNX files, and of arms as chains in MuJoCo.

They are `agent` and `mujoco_chain`: each needs the libraries of its own extra alone.
"""
