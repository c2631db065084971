"""Define the recurrent multilayer perceptron, the paper's "RNN"."""

from __future__ import annotations

from splitband.networks import plain
from splitband.networks.cell import are_plain, check_sizes
from splitband.networks.in_numpy import dense
from splitband.networks.layers import Tensor, nn, torch
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr


class EulerMLP(WithRepr, nn.Module):
    """A multilayer perceptron, integrated by Euler steps: the paper's "RNN" (supplement).

    h_{n+1} = h_n + dt f(h_n, u_n) with three layers and tanh between them; the observation is
    fixed: y is the first `ny` entries of h. A recognition network maps the whole warm-up, of fixed
    length, to h_R. The state is not corrected by y.

    Parameters
    ----------
    ny : Number of measured channels.
    warmup : R, samples of the warm-up.
    state_size : Size of h, at least `ny` (the paper's input_dim).
    hidden_size : Width of f.
    recognition_size : Width of the recognition network (the paper's rec_dim).
    step_size : dt of the Euler step, in an arbitrary unit of time.
    nu : Number of known inputs of f.
    """

    label = "euler-mlp"

    def __init__(  # noqa: PLR0913
        self,
        ny: int = 1,
        warmup: int = 10,
        state_size: int = 4,
        hidden_size: int = 500,
        recognition_size: int = 100,
        step_size: float = 1.0,
        nu: int = 0,
    ) -> None:
        super().__init__()
        sizes = {"ny": ny, "warmup": warmup, "state_size": state_size, "hidden_size": hidden_size}
        sizes["recognition_size"] = recognition_size
        nu, ny, warmup, state_size, hidden_size, recognition_size = check_sizes(nu, **sizes)
        if state_size < ny:
            raise InputError(f"state_size must be at least ny = {ny}, got {state_size}")
        self.ny, self.nu, self.warmup = ny, nu, warmup
        self.state_size, self.hidden_size = state_size, hidden_size
        self.recognition_size, self.step_size = recognition_size, step_size
        self.dynamics = nn.Sequential(
            nn.Linear(state_size + nu, hidden_size),
            nn.Tanh(),
            nn.Linear(hidden_size, hidden_size),
            nn.Tanh(),
            nn.Linear(hidden_size, state_size),
        )
        self.recognition = nn.Sequential(
            nn.Linear(warmup * (ny + nu), recognition_size),
            nn.Tanh(),
            nn.Linear(recognition_size, recognition_size),
            nn.Tanh(),
            nn.Linear(recognition_size, state_size),
            nn.Tanh(),
        )

    def sized(self, ny: int, nu: int, warmup: int) -> EulerMLP:
        """Return a new cell with equal state size, widths and step."""
        sizes = self.state_size, self.hidden_size, self.recognition_size
        return EulerMLP(ny, warmup, *sizes, self.step_size, nu)

    def size_in_words(self) -> str:
        """Return the state size and the width, for tables."""
        return f"{self.state_size} states, {self.hidden_size} hidden units"

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        """Return h_R from the last R measured samples; raises ValueError for fewer samples."""
        if y_warmup.shape[1] < self.warmup:
            raise InputError(
                f"the warm-up must have at least {self.warmup} samples, got {y_warmup.shape[1]}"
            )
        samples = y_warmup if u is None else torch.cat([y_warmup, u], dim=-1)
        return self.recognition(samples[:, -self.warmup :].flatten(1))

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        """Return h after one Euler step, shape `(batch, state_size)`; `y` is not used."""
        return h + self.step_size * self.dynamics(h if u is None else torch.cat([h, u], dim=-1))

    def observe(self, h: Tensor) -> Tensor:
        """Return the first `ny` entries of h."""
        return h[:, : self.ny]

    def fusable(self) -> bool:
        """Return whether the layers have their original types and no hooks."""
        kinds = (nn.Linear, nn.Tanh, nn.Linear, nn.Tanh, nn.Linear)
        return len(self.dynamics) == len(kinds) and are_plain(
            (self.dynamics, nn.Sequential), *zip(self.dynamics.children(), kinds, strict=True)
        )

    def in_numpy(self) -> plain.PlainEulerMLP | None:
        """Return the cell in NumPy; None where its layers have been replaced."""
        dynamics, recognition = dense(self.dynamics), dense(self.recognition)
        if dynamics is None or recognition is None:
            return None
        return plain.PlainEulerMLP(dynamics, recognition, self.ny, self.warmup, self.step_size)

    def fused_rollout(self, y_warmup: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
        """Compute the rollout in one compiled call on the CPU."""
        from splitband.kernels.euler_mlp import euler_rollout  # noqa: PLC0415  numba is slow to load

        warmup = y_warmup.shape[1]
        past, future = (None, None) if u is None else (u[:, :warmup], u[:, warmup:])
        h = self.initial_state(y_warmup, past)
        weights = (p for layer in self.dynamics.children() for p in layer.parameters())
        return euler_rollout(h, steps, self.ny, self.step_size, future, *weights)
