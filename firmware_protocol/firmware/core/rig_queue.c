#include "rig_queue.h"

enum { MASK = BOARD_QUEUE - 1 };

// Main's copy of the queue's variables. The interrupt may change the queue after the copy.
struct view {
    uint32_t next;
    uint16_t first, count, frames;
    uint16_t u; // code in force
    bool wrapped;
};

void rig_queue_begin(struct rig_queue *queue, uint16_t u_rest)
{
    queue->next = 0;
    queue->first = queue->first_frame = 0;
    queue->count = queue->frames = 0;
    queue->dry = 0;
    queue->wrapped = false;
    queue->in_force = (struct rig_setpoint){.u = u_rest, .seq = 0};
}

void rig_queue_empty(struct rig_queue *queue)
{
    const uint8_t before = board_irq_save();
    queue->count = queue->frames = 0;
    board_irq_restore(before);
}

uint16_t rig_queue_count(const struct rig_queue *queue)
{
    const uint8_t before = board_irq_save();
    const uint16_t count = queue->count;
    board_irq_restore(before);
    return count;
}

// Copies the values that the interrupt advances.
static struct view view_of(const struct rig_queue *queue)
{
    const uint8_t before = board_irq_save();
    const struct view view = {
        .next = queue->next,
        .first = queue->first,
        .count = queue->count,
        .frames = queue->frames,
        .u = queue->in_force.u,
        .wrapped = queue->wrapped,
    };
    board_irq_restore(before);
    return view;
}

// Returns true if the step between two codes exceeds `slew`.
static bool too_steep(const rig_config_t *config, uint16_t from, uint16_t to)
{
    return (from < to ? to - from : from - to) > config->slew;
}

// Finds the first code outside [u_min, u_max]. Codes that come too late are checked, too.
static bool leaves_range(const rig_config_t *config, const rig_setpoints_t *m, uint16_t *refused)
{
    for (uint8_t i = 0; i < m->n; i++) {
        if (m->u[i] < config->u_min || m->u[i] > config->u_max) {
            *refused = m->u[i];
            return true;
        }
    }
    return false;
}

// Finds the first code whose step is too large. The first code of the frame is for the sample
// `next` + `offset`.
static bool leaves_slew(const struct rig_queue *queue, const struct view *view,
    const rig_config_t *config, const rig_setpoints_t *m, int32_t offset, uint16_t *refused)
{
    if (config->slew == 0)
        return false;
    for (uint8_t i = 1; i < m->n; i++) {
        if (too_steep(config, m->u[i - 1], m->u[i])) {
            *refused = m->u[i];
            return true;
        }
    }
    *refused = m->u[0];
    const bool is_first = m->k0 == 0 && offset <= 0 && !view->wrapped;
    if (is_first && too_steep(config, config->u_rest, m->u[0]))
        return true;
    if (view->count) {
        const uint16_t last = queue->codes[(view->first + view->count - 1) & MASK];
        return offset == view->count && too_steep(config, last, m->u[0]);
    }
    if (offset > 0 || offset <= -(int32_t)m->n)
        return false;
    // The queue is empty. The step counts from the code in force, whatever codes for earlier
    // samples the frame contains.
    *refused = m->u[-offset];
    return too_steep(config, view->u, *refused);
}

// Adds `n` codes to the queue's count. Returns false if the queue ran empty after the copy `view`:
// the codes are then in the wrong places.
static bool publish(struct rig_queue *queue, const struct view *view, uint8_t n, uint16_t seq)
{
    bool in_time = true;
    const uint8_t before = board_irq_save();
    if (queue->next - view->next > view->count) {
        in_time = false;
    } else if (n) {
        uint16_t frame = queue->first_frame + queue->frames;
        if (frame >= RIG_QUEUE_FRAMES)
            frame -= RIG_QUEUE_FRAMES;
        queue->frame_seqs[frame] = seq;
        queue->frame_codes[frame] = n;
        queue->frames++;
        queue->count += n;
    }
    board_irq_restore(before);
    return in_time;
}

enum rig_put rig_queue_put(
    struct rig_queue *queue, const rig_config_t *config, const rig_setpoints_t *m, uint16_t *refused)
{
    if (leaves_range(config, m, refused))
        return RIG_PUT_OUT_OF_RANGE;
    for (;;) { // repeat if the queue ran empty during the pass; a pass takes less than a Ts
        const struct view view = view_of(queue);
        const int32_t offset = (int32_t)(m->k0 - view.next);
        if (leaves_slew(queue, &view, config, m, offset, refused))
            return RIG_PUT_TOO_STEEP;
        if (offset > view.count || offset <= -(int32_t)m->n)
            return RIG_PUT;
        uint8_t i = offset < 0 ? -offset : 0;
        uint16_t at = offset < 0 ? 0 : offset; // position after `first`
        for (; i < m->n && at < view.count; i++, at++) {
            if (queue->codes[(view.first + at) & MASK] != m->u[i])
                return RIG_PUT_DISAGREES;
        }
        uint8_t n = 0;
        if (view.frames < RIG_QUEUE_FRAMES) {
            for (; i < m->n && at < BOARD_QUEUE; i++, at++, n++)
                queue->codes[(view.first + at) & MASK] = m->u[i];
        }
        if (publish(queue, &view, n, m->seq))
            return RIG_PUT;
    }
}

bool rig_queue_take(struct rig_queue *queue, const rig_config_t *config)
{
    queue->next++;
    queue->wrapped |= queue->next == 0;
    if (queue->count) {
        queue->in_force.u = queue->codes[queue->first];
        queue->in_force.seq = queue->frame_seqs[queue->first_frame];
        queue->first = (queue->first + 1) & MASK;
        queue->count--;
        if (--queue->frame_codes[queue->first_frame] == 0) {
            queue->frames--;
            if (++queue->first_frame == RIG_QUEUE_FRAMES)
                queue->first_frame = 0;
        }
        queue->dry = 0;
        return true;
    }
    if (queue->dry <= UINT8_MAX)
        queue->dry++;
    if (config->underrun != RIG_UNDERRUN_HOLD || queue->dry > config->hold)
        queue->in_force = (struct rig_setpoint){.u = config->u_rest, .seq = 0};
    return false;
}
