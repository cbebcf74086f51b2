"""De Leon and Berne's isomerisation: two wells at y = ±1/√2, a saddle, and a Morse oscillator across.

    H = (p_x² + p_y²)/2m + D (1 - e^(-λx))² + V (y⁴ - 2 w² y²)/w⁴ e^(-ζλx) + V

Source: De Leon, Berne, Intramolecular rate process: Isomerization dynamics and the transition to chaos, J. Chem. Phys.
75 (1981) 3495.
"""

import casadi as ca

import dpcontrol as dp

NUMBERS = {"m": 8.0, "D": 10.0, "lambda": 1.0, "zeta": 1.0, "V": 1.0, "w": 0.5**0.5}


def hamiltonian(q, p, c):
    (x, y), (px, py) = q, p
    morse = c["D"] * (1 - ca.exp(-c["lambda"] * x)) ** 2
    wells = c["V"] / c["w"] ** 4 * y**2 * (y**2 - 2 * c["w"] ** 2) * ca.exp(-c["zeta"] * c["lambda"] * x)
    return (px**2 + py**2) / (2 * c["m"]) + morse + wells + c["V"]


def de_leon_berne():
    return dp.System.from_hamiltonian(
        "de-leon-berne",
        hamiltonian,
        coordinates=("x", "y"),
        parameters=NUMBERS,
        equilibria={"barrier": (0.0, 0.0), "well": (0.2, 0.7)},
        scale=0.5,
    )
