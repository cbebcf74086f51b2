# %% [markdown]
# # Controllers under model mismatch
# The share of completed turns if the plant differs from the model, for two laws with the same seeds.

# %%
from matplotlib.figure import Figure

import dpcontrol as dp

mismatches = (0.05, 0.2, 0.35, 0.5)
laws = {"controller": ["adaptive", "tvlqr"]}
campaigns = [dp.campaign("outer-turn", runs=16, mismatch=m, over=laws, workers=1) for m in mismatches]

# %% The share of completed runs with Wilson's interval.
figure = Figure(figsize=(7, 4.5), layout="constrained")
axes = figure.subplots()
for k, law in enumerate(laws["controller"]):
    shares = [campaign.results[k].completed for campaign in campaigns]
    rates = [share.rate for share in shares]
    below = [max(share.rate - share.low, 0.0) for share in shares]
    above = [max(share.high - share.rate, 0.0) for share in shares]
    axes.errorbar([100 * m for m in mismatches], rates, yerr=(below, above), marker="o", capsize=3, label=law)
axes.set(xlabel="mismatch (%)", ylabel="share completed", ylim=(0, 1.05), title="outer-turn, 16 runs each")
axes.legend()

# %%
figure.savefig("mismatch.png", dpi=110)
