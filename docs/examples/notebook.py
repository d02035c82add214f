# %% [markdown]
# # A pearl in a notebook
#
# The package `nacre` bakes, reads and evaluates in memory; tables are NumPy arrays. This notebook is
# written by `tools/notebook.py` from `docs/examples/notebook.py`, and a test runs its cells.

# %%
import matplotlib.pyplot as plt
import numpy as np

import nacre

print(nacre.recipes())

# %% [markdown]
# ## Bake
#
# A recipe is a built-in name, a path, or a dictionary. `table.meta` is all that the file knows about itself.

# %%
recipe = {"name": "thin", "stack": {"layers": 60, "aragonite": {"thickness_nm": 340}}, "look": {"coherence": 0.8}}
table = nacre.bake(recipe, solver="doubling", accuracy=1)
middle = table.meta["per_incidence"][len(table.theta_i) // 2]
print({name: round(middle[name], 4) for name in ("theta_i_deg", "albedo", "transmitted", "absorbed")})

# %% [markdown]
# ## The lobe
#
# `Pearl` evaluates many directions at a call: f·cos θ of the light, linear sRGB, per steradian.

# %%
pearl = nacre.Pearl(table, depth=0.5)
view = np.radians(30)
angles = np.radians(np.linspace(-85, 85, 341))
wi = [np.sin(view), 0, np.cos(view)]
wo = np.stack([-np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
value = pearl.eval(wi, wo)
print(value.shape, "peak at", round(float(np.degrees(angles[value[:, 1].argmax()])), 1), "degrees")

figure, axis = plt.subplots(figsize=(6, 3))
axis.plot(np.degrees(angles), value)
axis.set(xlabel="exit angle, degrees", ylabel="f·cos θ, 1/sr", title="The lobe at 30°")
figure.tight_layout()

# %% [markdown]
# ## The colour of the stack
#
# `nacre.thinfilm` solves stacks of thin films, many at a call.

# %%
n = np.array([1.0] + [1.683, 1.43] * 30 + [1.683])
d_nm = np.array([455.0, 20.0] * 30)
nm = np.linspace(400, 700, 301)
reflected = nacre.thinfilm.spectrum(n, d_nm, nm, [0, 30, 60]).R
print("peak near normal incidence:", nm[reflected.s[0].argmax()], "nm")

figure, axis = plt.subplots(figsize=(6, 3))
for at, spectrum in zip((0, 30, 60), (reflected.s + reflected.p) / 2, strict=True):
    axis.plot(nm, spectrum, label=f"{at}°")
axis.set(xlabel="wavelength, nm", ylabel="reflectance", title="Thirty pairs, three angles")
axis.legend()
figure.tight_layout()
