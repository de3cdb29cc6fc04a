"""The demo: controllers and agents that ship, side by side on the paper's arm."""
