"""Models: a scene prepared for computation, its statics, inverse statics and simulation."""
