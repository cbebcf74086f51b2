# %% [markdown]
# # From rest and back
# What a rig can do: hang still, swing up to Down-Up, turn the outer arm there, and come back to rest; on arms that are
# off by 5 %, with encoders, an estimator and feedback.

# %%
import dpcontrol as dp

planned = dp.plan("turn-from-rest")
run = dp.run(planned, mismatch=0.05, seed=1)
print(run.score().sentence)

# %%
dp.picture(run, file="from-rest.png")
