from .zhang import FEWEST_CIRCLES as FEWEST_CIRCLES, zhang_start as zhang_start
