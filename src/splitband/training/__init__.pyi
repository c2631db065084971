from .loop import fit as fit
from .settings import History as History
from .settings import Progress as Progress
from .settings import Settings as Settings
from .settings import default_warmup as default_warmup
