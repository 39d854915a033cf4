"""Schemas of the pipelines' configurations: parameters of the library, and those of the pipelines.

A key of ``conf/`` is a field of exactly one dataclass. Classes that extend a class of the library add a tag, which
distinguishes alternatives, and parameters that only the pipeline needs; an instance *is* an object of the library and
is passed to it unchanged. All keys are required: ``conf/`` has the values.
"""

from pipelines.config.calibration import (
    BoardPlaceConfig,
    CalibrateCameraConfig,
)
from pipelines.config.common import (
    ActionSpaceConfig,
    ExecutorConfig,
    PathsConfig,
    PipelineConfig,
    TrackingConfig,
)
from pipelines.config.execution import (
    CellConfig,
    EvaluateExecutionConfig,
    ExecuteConfig,
    RobotConfig,
    SafetyConfig,
    SegmenterConfig,
    SimulatedCellConfig,
    UrRtdeCellConfig,
)
from pipelines.config.groups import (
    ActorCriticImitationLearnerConfig,
    C3POLearnerConfig,
    ClosedLoopKRRTConfig,
    CraftedHeuristicConfig,
    DHRRTConfig,
    DQNLearnerConfig,
    ExpertIterationLearnerConfig,
    GreedyConfig,
    KinodynamicRRTConfig,
    LearnedHeuristicConfig,
    ObservationConfig,
    PlannerConfig,
    QImitationLearnerConfig,
    RecedingHorizonConfig,
    RoundValidationConfig,
    ValidationConfig,
    VideoConfig,
)
from pipelines.config.segmenter import (
    EvaluateSegmenterConfig,
    GenerateFramesConfig,
    TrainSegmenterConfig,
)
from pipelines.config.stages import (
    DemonstrationsConfig,
    EvaluateConfig,
    ExpertIterationConfig,
    ExportDemosConfig,
    GenerateDemosConfig,
    PlayConfig,
    PlayVideoConfig,
    ReportConfig,
    SweepsConfig,
    TrainILConfig,
    TrainRLConfig,
    TuneCraftedConfig,
    VerifyDemosConfig,
    VideosConfig,
)
from pipelines.config.suites import (
    suite_overrides,
)

__all__ = [
    "ActionSpaceConfig",
    "ActorCriticImitationLearnerConfig",
    "BoardPlaceConfig",
    "C3POLearnerConfig",
    "CalibrateCameraConfig",
    "CellConfig",
    "ClosedLoopKRRTConfig",
    "CraftedHeuristicConfig",
    "DHRRTConfig",
    "DQNLearnerConfig",
    "DemonstrationsConfig",
    "EvaluateConfig",
    "EvaluateExecutionConfig",
    "EvaluateSegmenterConfig",
    "ExecuteConfig",
    "ExecutorConfig",
    "ExpertIterationConfig",
    "ExpertIterationLearnerConfig",
    "ExportDemosConfig",
    "GenerateDemosConfig",
    "GenerateFramesConfig",
    "GreedyConfig",
    "KinodynamicRRTConfig",
    "LearnedHeuristicConfig",
    "ObservationConfig",
    "PathsConfig",
    "PipelineConfig",
    "PlannerConfig",
    "PlayConfig",
    "PlayVideoConfig",
    "QImitationLearnerConfig",
    "RecedingHorizonConfig",
    "ReportConfig",
    "RobotConfig",
    "RoundValidationConfig",
    "SafetyConfig",
    "SegmenterConfig",
    "SimulatedCellConfig",
    "SweepsConfig",
    "TrackingConfig",
    "TrainILConfig",
    "TrainRLConfig",
    "TrainSegmenterConfig",
    "TuneCraftedConfig",
    "UrRtdeCellConfig",
    "ValidationConfig",
    "VerifyDemosConfig",
    "VideoConfig",
    "VideosConfig",
    "suite_overrides",
]
