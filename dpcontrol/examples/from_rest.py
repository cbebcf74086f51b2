# %% [markdown]
# # From rest and back
# From rest, the arms swing up to Down-Up, the outer arm turns there, and the arms return to rest. The parameters have
# errors of 5 %, and the loop has encoders, an estimator and feedback.

# %%
import dpcontrol as dp

planned = dp.plan("turn-from-rest")
run = dp.run(planned, mismatch=0.05, seed=1)
print(run.score().sentence)

# %%
dp.picture(run, file="from-rest.png")
