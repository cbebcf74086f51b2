"""Multiple shooting: orbits as nodes, solved by Newton's method, open or closed, and refined in 113 bits."""
