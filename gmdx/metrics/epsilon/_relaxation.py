"""Lower bounds of epsilon from a semidefinite relaxation, proved by eigenvalues.

Let y_i = (t - c_i . u, B_i^T u). That t >= h(u) says that every y_i lies in the Lorentz
cone, i.e. that the Hermitian 2x2 matrix rho_i = sum_a y_ia sigma_a (Pauli matrices) is
positive. So for any multipliers l_i >= 0 and Hermitian 4x4 matrices P_ij >= 0,

    t^2 - theta |u|^2 - sum_i l_i det(rho_i) - sum_ij tr(P_ij (rho_i x rho_j)) >= 0 for all (t, u)

proves h(u)^2 >= theta |u|^2. The left side is one 7x7 matrix: the largest theta is a small
semidefinite programme, and whatever multipliers the solver returns, the bound they prove
follows from eigenvalues alone. The family `transposed` takes rho_j^T instead of rho_j; both
together span every positive form on two Lorentz cones (Stormer, Woronowicz).
"""

from dataclasses import dataclass
from functools import lru_cache

import clarabel
import numpy as np
import scipy.sparse

from gmdx.arrays import Array, Float
from gmdx.metrics.epsilon._conic import solve_conic
from gmdx.metrics.epsilon.wrench import WrenchCones, principal_axes

Pairs = tuple[tuple[int, int], ...]

_LORENTZ = np.diag([1.0, -1.0, -1.0, -1.0])
_PAULI = np.array([[[1, 0], [0, 1]], [[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
_KRON = np.array([np.kron(a, b) for a in _PAULI for b in _PAULI]) / 4
_KRON_TRANSPOSED = np.array([np.kron(a, b.T) for a in _PAULI for b in _PAULI]) / 4
_DRAWN = np.array([0.0, 1e-7, 1e-5, 1e-4, 2e-3])
_ROUNDING = 200 * np.finfo(float).eps  # of sums of some 100 products, relative to their size


@dataclass(frozen=True)
class LowerBound:
    """A proved lower bound, and where the relaxation believes the minimum to be."""

    value: float  # epsilon is at least this; 0 if nothing was proved
    directions: Float[Array, "m 6"]  # unit, the likeliest first


@dataclass(frozen=True)
class _Template:
    """What does not change from one grasp to the next: the programme's sparse structure."""

    indices: Array
    indptr: Array
    data: Array
    slots: Array  # (28, v): where the entries of the 7x7 matrix go in `data`
    families: tuple[Array, ...]


def relaxation_bound(
    cones: WrenchCones, pairs: Pairs, *, transposed: bool, tol: float
) -> LowerBound:
    """The bound of the relaxation with products of the contact pairs in `pairs`.

    Args:
        cones: Contacts that span all six dimensions.
        pairs: Which products of contacts take part; more of them tighten the bound.
        transposed: Whether to use the family of transposed products as well.
        tol: Relative accuracy asked of the solver. The bound is valid whatever it is.
    """
    # In coordinates in which K is round the programme is well-posed and its proof accurate.
    principal = principal_axes(cones)
    width = principal.widths**2
    if not principal.widths[0] > 1e-12 * principal.widths[-1]:
        return LowerBound(0.0, np.zeros((0, 6)))
    rounding = principal.rounding
    forms = _forms(cones, rounding)
    k = len(forms)
    template = _template(k, pairs, transposed)
    data = template.data.copy()
    ball = np.diag([0.0, *(width[0] / width)])
    data[template.slots] = -_svec(_matrices(forms, pairs, ball, transposed)).T
    size = int(template.indptr.size) - 1
    rows = k + 28 + 36 * len(template.families) * len(pairs)
    b = np.zeros(rows)
    b[k] = 1.0  # t^2
    q = np.zeros(size)
    q[0] = -1.0
    blocks = len(template.families) * len(pairs)
    solution = solve_conic(
        q,
        scipy.sparse.csc_matrix((data, template.indices, template.indptr), shape=(rows, size)),
        b,
        [clarabel.NonnegativeConeT(k), clarabel.PSDTriangleConeT(7)]
        + [clarabel.PSDTriangleConeT(8)] * blocks,
        tol=tol,
        feasibility=min(tol, 1e-4),
    )
    x = solution.x
    if not np.isfinite(x).all() or not np.isfinite(solution.z).all():
        return LowerBound(0.0, np.zeros((0, 6)))
    value = _proved(forms, pairs, x[1 : k + 1], x[k + 1 :], template.families, width)
    moment = _smat(solution.z[k : k + 28])
    moment[1:] = rounding @ moment[1:]
    moment[:, 1:] = moment[:, 1:] @ rounding.T
    return LowerBound(value, _directions(moment))


def _proved(
    forms: Float[Array, "k 4 7"],
    pairs: Pairs,
    multipliers: Float[Array, "k"],
    products: Float[Array, "m"],
    families: tuple[Array, ...],
    width: Float[Array, "6"],
) -> float:
    """The epsilon that multipliers prove, after making them exactly admissible.

    In rounded coordinates x, |u|^2 is x^T diag(1 / width) x.
    """
    total = np.zeros((7, 7))
    for form, weight in zip(forms, np.maximum(multipliers, 0.0), strict=True):
        total += weight * form.T @ _LORENTZ @ form
    size = np.abs(total).max()
    blocks = products.reshape(len(families), len(pairs), 16)
    for family, matrices in zip(families, blocks, strict=True):
        # tr(P (sigma_a x sigma_b)) / 4 for the nearest P >= 0.
        w, v = np.linalg.eigh(np.tensordot(matrices, family, axes=(1, 0)))
        positive = (v * np.maximum(w, 0.0)[:, None, :]) @ v.conj().transpose(0, 2, 1)
        back = 4.0 * np.einsum("aij,pji->pa", family, positive).real.reshape(-1, 4, 4)
        for (i, j), matrix in zip(pairs, back, strict=True):
            term = forms[i].T @ matrix @ forms[j]
            total += 0.5 * (term + term.T)
            size = max(size, np.abs(term).max())
    # Where (t, u) and (t, -u) are both worst, the t^2 entry of the matrix vanishes and rounding
    # would decide: multipliers drawn a little towards 0 are admissible too and leave some of it.
    rest = -(1.0 - _DRAWN)[:, None, None] * total
    rest[:, 0, 0] += 1.0
    corner = rest[:, 0, 0]
    rest = rest[corner > 0]
    corner = corner[corner > 0, None, None]
    edge = rest[:, 1:, :1]
    outer = edge @ edge.transpose(0, 2, 1) / corner
    sizes = np.maximum(max(size, 1.0), np.abs(outer).max(axis=(1, 2), initial=0.0))
    # Rounding a thin K to a ball magnifies the rounding of its contacts' wrenches as much.
    blur = _ROUNDING * (1.0 + 0.1 * np.sqrt(width[-1] / width[0]))
    schur = rest[:, 1:, 1:] - outer - blur * sizes[:, None, None] * np.eye(6)
    w, v = np.linalg.eigh(schur)
    positive = w[:, 0] > _ROUNDING * w[:, -1]
    if not positive.any():
        return 0.0
    w, v = w[positive], v[positive]
    # The largest theta with schur >= theta / width, from the norm of schur^(-1/2) width^(-1/2).
    low = np.linalg.norm(v.transpose(0, 2, 1) / np.sqrt(w[:, :, None] * width), 2, axis=(1, 2))
    return float(((1.0 - _ROUNDING * w[:, -1] / w[:, 0]) / low).max())


def _directions(moment: Float[Array, "7 7"]) -> Float[Array, "m 6"]:
    """Candidates for the worst wrench from the solution's moment matrix of (t, u)."""
    w, v = np.linalg.eigh(moment)
    order = np.argsort(w)[::-1][:3]
    u = v[1:, order].T * np.where(v[0, order] < 0, -1.0, 1.0)[:, None]
    both = np.concatenate([np.stack([a, -a]) for a in u])
    length = np.linalg.norm(both, axis=1)
    directions: Array = both[length > 1e-9] / length[length > 1e-9, None]
    return directions


def _forms(cones: WrenchCones, rounding: Float[Array, "6 6"]) -> Float[Array, "k 4 7"]:
    """A_i: (t, x) to y_i, where u = rounding x."""
    k = len(cones.centers)
    forms = np.zeros((k, 4, 7))
    forms[:, 0, 0] = 1.0
    forms[:, 0, 1:] = -cones.centers @ rounding
    forms[:, 1:, 1:] = cones.spreads @ rounding
    return forms


def _matrices(
    forms: Float[Array, "k 4 7"], pairs: Pairs, ball: Float[Array, "7 7"], transposed: bool
) -> Float[Array, "v 7 7"]:
    """Coefficients of every variable in the 7x7 matrix: theta, l_i, and 16 a product."""
    quadratic = forms.transpose(0, 2, 1) @ _LORENTZ @ forms
    left, right = np.array(pairs, int).T
    outer = forms[left][:, :, None, :, None] * forms[right][:, None, :, None, :]
    outer = outer.reshape(-1, 7, 7)
    outer = 0.5 * (outer + outer.transpose(0, 2, 1))
    return -np.concatenate([ball[None], quadratic, outer] + ([outer] if transposed else []))


@lru_cache(maxsize=64)
def _template(k: int, pairs: Pairs, transposed: bool) -> _Template:
    families = (_KRON, _KRON_TRANSPOSED) if transposed else (_KRON,)
    blocks = len(families) * len(pairs)
    rows, columns = k + 28 + 36 * blocks, 1 + k + 16 * blocks
    matrix = np.zeros((rows, columns))
    matrix[np.arange(k), 1 + np.arange(k)] = -1.0
    matrix[k : k + 28] = 1.0
    for block in range(blocks):
        family = families[block // len(pairs)]
        real = np.block([[family.real, -family.imag], [family.imag, family.real]])
        matrix[
            k + 28 + 36 * block : k + 64 + 36 * block, 1 + k + 16 * block : 17 + k + 16 * block
        ] = -_svec(real).T
    sparse = scipy.sparse.csc_matrix(matrix)
    sparse.sort_indices()
    slots = np.flatnonzero((sparse.indices >= k) & (sparse.indices < k + 28))
    return _Template(
        indices=sparse.indices,
        indptr=sparse.indptr,
        data=sparse.data,
        slots=slots.reshape(columns, 28).T,
        families=families,
    )


def _svec(matrices: Float[Array, "m n n"]) -> Float[Array, "m t"]:
    """Upper triangles by columns, off-diagonal entries times sqrt 2, as Clarabel wants them."""
    n = matrices.shape[-1]
    column, row = np.tril_indices(n)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    return np.asarray(matrices[:, row, column] * weight)


def _smat(vector: Float[Array, "t"]) -> Float[Array, "n n"]:
    """The symmetric matrix that `_svec` flattened."""
    n = int((np.sqrt(8 * len(vector) + 1) - 1) / 2)
    column, row = np.tril_indices(n)
    matrix = np.zeros((n, n))
    matrix[row, column] = vector / np.where(row == column, 1.0, np.sqrt(2.0))
    return matrix + np.triu(matrix, 1).T
