import numpy as np
from trinoc.match.guided.further_views import with_further_views
from trinoc.match.guided.newlines import with_new_lines
from trinoc.match.guided.prolong import prolonged


def rounds(state, pictures, tuning, log=None):
    before=np.zeros((0,2,3))
    for k in range(tuning.rounds):
        state, seen = with_further_views(state, pictures, tuning, weigh=k == 0)
        state, new, before = with_new_lines(state, pictures, before, tuning)
        state, longer = prolonged(state, pictures, tuning)
        if log is not None: log.append((seen, new, longer))
        if not seen + new + longer:
            break
    return state
