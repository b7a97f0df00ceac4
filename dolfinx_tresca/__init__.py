"""Contact of elastic bodies with Coulomb or Tresca friction, for FEniCSx (DOLFINx).

For readers of the code: the page in the `__init__.py` of the room (folder) `dual` follows a solve
of linear bodies from call to table, that of `problem` continues with nonlinear bodies. Rooms import
only later ones of: adapt, problem, derivatives, contact, result, output, solution and guaranteed,
dual, floating, pairing and stiffness and solvers, scene, _base (docs/contribute/architecture.md).
"""

import dolfinx_tresca._base.requirements  # first: it loads MPI before DOLFINx
from dolfinx_tresca.adapt.refinement import refine
from dolfinx_tresca.adapt.solve import (
    AdaptiveSolution,
    Level,
    refinement_indicators,
    solve_adaptively,
)
from dolfinx_tresca.derivatives.goals import ContactTangent, GoalError, SurfaceTangent
from dolfinx_tresca.derivatives.tape import ProcessTape
from dolfinx_tresca.errors import (
    ContactError,
    ConvergenceError,
    InputError,
    MechanismError,
    MeshError,
    OutsideTheoryError,
    PairingError,
    StiffnessError,
)
from dolfinx_tresca.guaranteed.bound import GuaranteedError, GuaranteedGoal
from dolfinx_tresca.monitor import Iteration, ProgressBar
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output.files import SolutionWriter
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.problem.newton import NewtonOptions, NewtonRecord, NewtonStep
from dolfinx_tresca.problem.nonlinear import NonlinearContactProblem, NonlinearContactSolution
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.friction import Bonded, Coulomb, Frictionless, Preload, Tresca
from dolfinx_tresca.scene.mesh import MESHES, TaggedMesh, read_gmsh
from dolfinx_tresca.scene.obstacle import RigidCylinder, RigidObstacle, RigidPlane, RigidSphere
from dolfinx_tresca.scene.pair import (
    ContactForce,
    ContactPair,
    MeanPressure,
    MeanSlip,
    NormalForce,
    PressureNorm,
)
from dolfinx_tresca.solution.evaluation import NodeCounts
from dolfinx_tresca.solution.fields import ContactState, SurfaceFields
from dolfinx_tresca.status import AdaptiveStatus, ContactStatus
from dolfinx_tresca.table import Units
from dolfinx_tresca.touching_faces import Contacts, contacts

__all__ = [
    "MESHES",
    "AdaptiveSolution",
    "AdaptiveStatus",
    "Bonded",
    "ContactError",
    "ContactForce",
    "ContactOperators",
    "ContactPair",
    "ContactProblem",
    "ContactSolution",
    "ContactState",
    "ContactStatus",
    "ContactTangent",
    "Contacts",
    "ConvergenceError",
    "Coulomb",
    "Frictionless",
    "GoalError",
    "GuaranteedError",
    "GuaranteedGoal",
    "InputError",
    "Iteration",
    "Level",
    "MeanPressure",
    "MeanSlip",
    "MechanismError",
    "MeshError",
    "NewtonOptions",
    "NewtonRecord",
    "NewtonStep",
    "NodeCounts",
    "NonlinearContactProblem",
    "NonlinearContactSolution",
    "NormalForce",
    "OutsideTheoryError",
    "PairingError",
    "Preload",
    "PressureNorm",
    "ProcessTape",
    "ProgressBar",
    "RigidCylinder",
    "RigidObstacle",
    "RigidPlane",
    "RigidSphere",
    "SolutionWriter",
    "SolverOptions",
    "StiffnessError",
    "SurfaceFields",
    "SurfaceTangent",
    "TaggedMesh",
    "Tresca",
    "Units",
    "contacts",
    "read_gmsh",
    "refine",
    "refinement_indicators",
    "solve_adaptively",
]
__version__ = "0.2.0"
