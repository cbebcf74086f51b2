# %% [markdown]
# # Falling, and getting up
# Two blows on the arms are more than the law bears. The arms are calmed, the pendulum rises from rest again, and does
# the symbol that failed once more. `dpcontrol run turn-from-rest --hours 8` does so for a night.

# %%
import dpcontrol as dp

trouble = dp.RunOptions(on_fall="resume", pushes=2, push_impulse=0.03, lag=0.005, travel=0.8)
run = dp.run("turn-from-rest", mismatch=0.05, seed=4, options=trouble)
print(run.score().sentence)

# %%
dp.picture(run, file="night.png")
