"""Released networks: trained heuristics of both action spaces and both observations, with their cards.

There are two procedures: ``best``, expert iteration on top of the paper's training, and ``paper``, the paper's training
alone (imitation, then DQN or C3PO). ``<procedure>/<action space>/<observation>/heuristic*.safetensors`` and ``.json``
have the layout of the outputs of the pipelines; the cards say from which commit, configuration, seed and data a network
comes, and how good it is on which task instances.
"""

from visualrhp.pretrained.release import PROCEDURES, Procedure, load_pretrained, pretrained_folder, pretrained_path

__all__ = ["PROCEDURES", "Procedure", "load_pretrained", "pretrained_folder", "pretrained_path"]
