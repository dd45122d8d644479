from .loopback import ADDRESS as ADDRESS, REFUSAL as REFUSAL, may_ask as may_ask
from .space import SpaceServer as SpaceServer
