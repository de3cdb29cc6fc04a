"""Rendering of arms without a display: backbones and tendons as curves, shaded pictures."""
