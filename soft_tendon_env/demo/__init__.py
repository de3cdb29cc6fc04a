"""The demo: controllers and the agent that ships, side by side on the paper's arm."""
