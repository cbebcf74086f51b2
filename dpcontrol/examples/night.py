# %% [markdown]
# # Recovery after a fall
# Two blows on the arms exceed the law's limits. A flight carries the arms back to a stop, and the failed symbol is
# repeated. `dpcontrol run turn-from-rest --hours 8` does so for a night.

# %%
import dpcontrol as dp

trouble = {"on_fall": "resume", "pushes": 2, "push_impulse": 0.03, "lag": 0.005, "travel": 0.8}
run = dp.run("turn-from-rest", mismatch=0.05, seed=4, settings=trouble)
print(run.score().sentence)

# %%
dp.picture(run, file="night.png")
