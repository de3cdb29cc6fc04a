"""Drawing of arms: curves in space and shaded pictures, without a display."""
