# %% [markdown]
# # A walk as a film
# The outer arm turns, the pendulum moves to Up-Down, the inner arm turns, and the pendulum returns. These are four
# symbols with two wraps at each stop, on one trajectory that needs no control.

# %%
import dpcontrol as dp

lab = dp.load_model("lab")
symbols = ["down-up +", "down-up > up-down", "up-down -", "up-down > down-up"]
walk = dp.shadow(dp.graph(lab, energy=0.2), symbols, wraps=[2, 2, 2])
print(walk.status)

# %% The page with a strip of poses, and the film.
dp.picture(walk, file="walk.png", film="walk.gif")
