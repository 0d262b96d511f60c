"""Predicted standard deviations of a planned experiment."""

from armrig.excitation.experiment_design.parametric import PlannedModel, predicted_std
from armrig.excitation.experiment_design.physical import predicted_parameter_std
from armrig.excitation.experiment_design.predicted_std import PredictedStd

__all__ = ["PlannedModel", "PredictedStd", "predicted_parameter_std", "predicted_std"]
