"""Observations of rows of arms: values over their units, clipped, as float32."""

from soft_tendon_env.compiler.compilation import kernel


@kernel
def scale_and_clip(values, scale, bound, out):
    """Values (rows, m) times scale (m,), within ±bound (m,), to out (rows, m) float32."""
    for row in range(values.shape[0]):
        for i in range(values.shape[1]):
            x = values[row, i] * scale[i]
            out[row, i] = -bound[i] if x < -bound[i] else bound[i] if x > bound[i] else x  # nan stays nan
