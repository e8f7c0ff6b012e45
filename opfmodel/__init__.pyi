# The public names and where they live, for type checkers and for __init__.py, which imports at first use.

from .analysis.analyze import (
    Analysis as Analysis,
    analyze as analyze,
)
from .analysis.bound import (
    Certificate as Certificate,
    certify as certify,
)
from .network import (
    Branch as Branch,
    Budget as Budget,
    Bus as Bus,
    Connection as Connection,
    DCLine as DCLine,
    FlexibleLoad as FlexibleLoad,
    Generator as Generator,
    Load as Load,
    Network as Network,
    PiecewiseLinear as PiecewiseLinear,
    Polynomial as Polynomial,
    Renewable as Renewable,
    Reserve as Reserve,
    Shunt as Shunt,
    Storage as Storage,
    from_pandapower as from_pandapower,
    from_pypsa as from_pypsa,
    read_network as read_network,
    write_network as write_network,
)
from .data.series import Profiles as Profiles
from .errors import OpfmodelError as OpfmodelError
from .horizon import Horizon as Horizon
from .forecasts import (
    Case as Case,
    Draw as Draw,
    Forecast as Forecast,
    Scenarios as Scenarios,
)
from .model import (
    Elastic as Elastic,
    largest as largest,
    total as total,
)
from .objectives.base import Objective as Objective
from .objectives.economic import Economic as Economic
from .objectives.linear_quadratic import LinearQuadratic as LinearQuadratic
from .objectives.loss_minimisation import LossMinimisation as LossMinimisation
from .objectives.setpoint_tracking import (
    SetpointTracking as SetpointTracking,
    Setpoints as Setpoints,
)
from .objectives.state_of_charge_tracking import StateOfChargeTracking as StateOfChargeTracking
from .objectives.stored_energy_value import StoredEnergyValue as StoredEnergyValue
from .objectives.voltage_deviation import VoltageDeviation as VoltageDeviation
from .plan import (
    End as End,
    MultiStage as MultiStage,
    Plan as Plan,
    Risk as Risk,
    Security as Security,
)
from .plan.commitment import (
    Commitment as Commitment,
    commit as commit,
)
from .plan.assessment import (
    Assessment as Assessment,
    assess as assess,
)
from .plan.security_cost import (
    SecurityCost as SecurityCost,
    security_cost as security_cost,
)
from .plan.power_flow import (
    PowerFlowResult as PowerFlowResult,
    power_flow as power_flow,
)
from .plan.single_stage import (
    SingleStageSequence as SingleStageSequence,
    single_stage_sequence as single_stage_sequence,
)
from .results.presented import (
    SavedRun as SavedRun,
    load_run as load_run,
)
from .scenario import (
    Scenario as Scenario,
    load_scenario as load_scenario,
)
from .simulation import (
    Checkpoint as Checkpoint,
    Controller as Controller,
    NominalPlant as NominalPlant,
    Outage as Outage,
    Plant as Plant,
    PowerFlow as PowerFlow,
    Redispatch as Redispatch,
    Run as Run,
    simulate as simulate,
)
from .study.report import report as report

__version__: str
