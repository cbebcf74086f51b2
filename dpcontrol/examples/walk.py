# %% [markdown]
# # A walk as a film
# The outer arm turns, the pendulum crosses over, the inner arm turns, and it crosses back: four symbols, with two
# wobbles at each stop, as one trajectory that needs no control.

# %%
import dpcontrol as dp

lab = dp.load_model("lab")
symbols = ["down-up +", "down-up > up-down", "up-down -", "up-down > down-up"]
walk = dp.shadow(dp.graph(lab, energy=0.2), symbols, wraps=[2, 2, 2])
print(walk.status)

# %% The page, as a strip of poses; and the film.
dp.picture(walk, file="walk.png", film="walk.gif")
