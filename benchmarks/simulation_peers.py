"""Exudyn's ANCFCable2D on the same cases, with its fastest options.

Options: the fast module (no range checks), sparse linear solver, modified Newton, generalised
alpha without numerical damping. The dense modal damping matrix is an ObjectGenericODE2 on the nodes with its Jacobian
declared zero. The iteration usually still converges, and the sparse tangent makes a step up to six times faster. If
Exudyn fails without the Jacobian, it is run with it. These were not faster: dense solvers, a full Newton iteration, a
Jacobian for each step, other limits of the contractivity. Zero initial accelerations cost accuracy.
"""

from __future__ import annotations

import contextlib
import io
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from sim.beam import AncfBeam
from sim.dynamics import State
from tracker import FloatArray

# Relative and absolute tolerance. The first is the loosest that leaves the error at that of the step; with the others,
# a step takes up to a fifth less time.
TOLERANCES = ((1e-6, 3e-8), (1e-5, 1e-6), (1e-4, 1e-6))


class PeerMissingError(ImportError):
    """Exudyn cannot be imported."""


def load() -> Any:
    """Import the module without range checks.

    Raises
    ------
    PeerMissingError
        If Exudyn is not installed or cannot be loaded.
    """
    sys.exudynFast = True  # type: ignore[attr-defined]  # Exudyn reads it: selects its module without range checks
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            import exudyn  # noqa: PLC0415 - a peer that may be missing
            import exudyn.itemInterface  # noqa: PLC0415
    except ImportError as error:
        msg = f"Exudyn was not run ({error}): pip install 'modalcam[benchmarks]'"
        raise PeerMissingError(msg) from error
    return exudyn


class ExudynBeam:
    """The cantilever in Exudyn, in the reference frame of its clamp.

    Parameters
    ----------
    exu : module
    beam : AncfBeam
        Uniform, hanging.
    state : State
    damping : array, shape (ndof, ndof)
    external_load : callable, optional
        Generalised load, shape (ndof,), as a function of time in s; called in Python at every evaluation.
    matrix_in_tangent : bool
        Whether the Jacobian includes the damping matrix.
    exact_integration : bool
        Whether the axial forces are integrated exactly, with five Gauss points, or with four, which is faster.
    """

    def __init__(
        self,
        exu: Any,
        beam: AncfBeam,
        state: State,
        damping: FloatArray,
        external_load: Callable[[float], FloatArray] | None = None,
        *,
        matrix_in_tangent: bool = False,
        exact_integration: bool = True,
    ) -> None:
        self._matrix_in_tangent = matrix_in_tangent
        items, p = exu.itemInterface, beam.properties
        self._exu = exu
        self._container = exu.SystemContainer()
        self._mbs = mbs = self._container.AddSystem()
        h = beam.element_length_m
        q, v = (np.concatenate([np.zeros(4), x]).reshape(-1, 4) for x in (state.q, state.v))
        nodes = [
            mbs.AddNode(
                items.NodePoint2DSlope1(
                    referenceCoordinates=[i * h, 0, 1, 0],
                    initialCoordinates=q[i].tolist(),
                    initialVelocities=v[i].tolist(),
                )
            )
            for i in range(p.elements + 1)
        ]
        for e in range(p.elements):
            cable = mbs.AddObject(
                items.ObjectANCFCable2D(
                    nodeNumbers=nodes[e : e + 2],
                    physicsLength=h,
                    useReducedOrderIntegration=int(not exact_integration),
                    physicsMassPerLength=p.density_kg_m3 * p.area_m2[e],
                    physicsBendingStiffness=p.elastic_modulus_pa * p.second_moment_m4[e],
                    physicsAxialStiffness=p.elastic_modulus_pa * p.area_m2[e],
                )
            )
            mass = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=cable))
            mbs.AddLoad(items.LoadMassProportional(markerNumber=mass, loadVector=[p.gravity_m_s2, 0, 0]))
        ground = mbs.AddNode(items.NodePointGround(referenceCoordinates=[0, 0, 0]))
        fixed = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
        for k in range(4):
            free = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=k))
            mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=[fixed, free]))
        self._attach(nodes, damping, external_load)
        self._sensor = mbs.AddSensor(
            items.SensorNode(
                nodeNumber=nodes[-1],
                outputVariableType=exu.OutputVariableType.Displacement,
                storeInternal=True,
                writeToFile=False,
            )
        )
        mbs.Assemble()

    def _attach(
        self, nodes: list[Any], damping: FloatArray, external_load: Callable[[float], FloatArray] | None
    ) -> None:
        n = 4 * len(nodes)
        matrix = np.zeros((n, n))
        matrix[4:, 4:] = damping
        zero = self._exu.MatrixContainer()
        zero.SetWithDenseMatrix(np.zeros((n, n)), useDenseMatrix=False)
        arguments: dict[str, Any] = {
            "nodeNumbers": nodes,
            "dampingMatrix": matrix,
        }
        if not self._matrix_in_tangent:
            arguments["jacobianUserFunction"] = lambda *_: zero
        if external_load is not None:
            load = np.zeros(n)

            def force(_mbs: Any, time_s: float, *_rest: Any) -> FloatArray:
                load[4:] = external_load(time_s)
                return load

            arguments["forceUserFunction"] = force
        self._mbs.AddObject(self._exu.itemInterface.ObjectGenericODE2(**arguments))

    def linearised(self) -> tuple[FloatArray, FloatArray]:
        """Mass and stiffness matrix about the initial state, with the four coordinates of the clamp first."""
        mass, stiffness, *_ = self._mbs.ComputeLinearizedSystem()
        return np.asarray(mass), np.asarray(stiffness)

    def run(
        self,
        duration_s: float,
        step_s: float,
        sample_s: float,
        *,
        relative: float = TOLERANCES[0][0],
        absolute: float = TOLERANCES[0][1],
    ) -> tuple[float, FloatArray]:
        """CPU seconds of the solver, and the axial and transverse displacement of the tip, shape (n, 2).

        Raises
        ------
        ArithmeticError
            If the solver fails.
        """
        settings = self._exu.SimulationSettings()
        integration = settings.timeIntegration
        integration.numberOfSteps = round(duration_s / step_s)
        integration.endTime = duration_s
        integration.newton.useModifiedNewton = True
        integration.newton.relativeTolerance = relative
        integration.newton.absoluteTolerance = absolute
        integration.generalizedAlpha.spectralRadius = 1.0
        integration.adaptiveStep = False
        integration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = sample_s
        settings.linearSolverType = self._exu.LinearSolverType.EigenSparse
        settings.parallel.numberOfThreads = 1
        printed = io.StringIO()
        start = time.process_time()
        try:
            with contextlib.redirect_stdout(printed):
                done = self._mbs.SolveDynamic(
                    settings,
                    solverType=self._exu.DynamicSolverType.GeneralizedAlpha,
                    showHints=False,
                    showCausingItems=False,
                )
        except (RuntimeError, ValueError) as error:
            msg = f"Exudyn's solver failed: {error!r:.80}"
            raise ArithmeticError(msg) from error
        cpu_s = time.process_time() - start
        if not done:
            msg = "Exudyn's solver failed"
            raise ArithmeticError(msg)
        return cpu_s, np.asarray(self._mbs.GetSensorStoredData(self._sensor))[:, 1:3]
