"""Files made for an arm: what takes simulations to make, is kept in a file, and is found by the arm it was made for."""
