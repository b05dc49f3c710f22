/* The simulator's kernel in C, to compare how well a C compiler optimises the same algorithm.
 *
 * describe, derivatives and integrate follow simulators/_outline.py and simulators/_kernels.py line by line,
 * with the same tables, for the cases of the comparison: smooth profile without pitch errors, no friction, no
 * pin displaced beyond the reach of Newton's method. See these files for names and explanations.
 * benchmarks/simulator.py writes the sizes and rows of the tables in front of this file, so they cannot differ.
 */
#include <math.h>
#include <stddef.h>

#define INLINE static inline __attribute__((always_inline))

/* The fields of the named tuples, in their order, all as double. */
typedef struct {
    double eccentricity, shortening, n_lobes, pin_radius, pin_circle_radius, clearance, tip_x, pit_x, pit_y,
        pit_nx, pit_ny, tip_radius, pit_radius, near, has_pitch_errors, profile_points;
} Wheel;
typedef struct { double n_sleeves, pitch_radius, sleeve_radius, gap_at_centre; } Joint;
typedef struct { double law, stiffness_factor, damping, inverse_ramp, constant_radius; } Contact;
typedef struct {
    double wheel_mass, wheel_inertia, output_inertia, brake_inertia, meter_stiffness, meter_damping;
} Body;

typedef struct { double sine, cosine; } Turn;
/* Moments: of the forces at the cam about the origin, on the wheel about the cam, on the output shaft. */
typedef struct { double on_cam, moment, moment_out; } Load;

/* Tables of one machine, and working memory. */
typedef struct {
    Wheel wheel;
    Joint joint;
    Contact contact, joint_contact;
    Body body;
    const double *pins, *mounts, *lobes, *wear, *sleeves;
    double seen[2][3];
    size_t counts[2][4];
    double feet[FEET_SIZE], flanks[2 * FLANK_SIZE], edges[2 * EDGE_SIZE], on_sleeves[2 * JOINT_SIZE];
} Machine;

INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double smaller(double a, double b) { return a < b ? a : b; }

INLINE Turn small_sincos(double x)
{
    if (fabs(x) > 0.02)
        return (Turn){sin(x), cos(x)};
    double y = x * x;
    return (Turn){x * (1.0 + y * (y / 120.0 - 1.0 / 6.0)), 1.0 + y * (y * (1.0 / 24.0 - y / 720.0) - 0.5)};
}

INLINE double cell(double phi) { return floor(phi * CELLS_PER_RADIAN + FIRST_BORDER); }

INLINE int moved_on(const double *seen, double phi, double eps)
{
    int same_cell = cell(phi) == seen[SEEN_CELL];
    int at_rest = fabs(eps - seen[SEEN_EPS]) < HOLDS_EPS;
    return !(same_cell && at_rest);
}

static void newton_feet(const Wheel *wheel, const double *restrict pins, double *restrict feet, Turn lobe)
{
    double e = wheel->eccentricity, inverse_m = 1.0 / wheel->shortening, n_lobes = wheel->n_lobes;
    double n_pins = n_lobes + 1.0, big_r = wheel->pin_circle_radius, inverse_ez = 1.0 / (e * n_pins);
    double largest = LARGEST_STEP * 16.0 / n_pins;
    size_t n = (size_t)n_pins;
    for (size_t j = 0; j < n; j++) {
        double cb = pins[PIN_COS + j], sb = pins[PIN_SIN + j];
        double dx = feet[DISPLACED_X + j], dy = feet[DISPLACED_Y + j];
        double qx = cb * lobe.cosine + sb * lobe.sine, qy = cb * lobe.sine - sb * lobe.cosine;
        double step = 0.0;
        for (int k = 0; k < NEWTON_STEPS; k++) {
            double y = step * step;
            double s1 = step * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0)));
            double v1 = y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0)));
            double x = n_pins * step;
            y = x * x;
            double s2 = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0))));
            double v2 =
                y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0))));
            double rx = dx + big_r * v1 + e * (qx * v2 + qy * s2);
            double ry = dy - big_r * s1 + e * (qy * v2 - qx * s2);
            double wx = (1.0 - v2) * qx - s2 * qy, wy = (1.0 - v2) * qy + s2 * qx;
            double hx = (1.0 - v1) * inverse_m + wx, hy = s1 * inverse_m + wy;
            double ahead = (ry * hx - rx * hy) * inverse_ez;
            double flat = hx * hx + hy * hy;
            double slope = flat + (rx * (hx + n_lobes * wx) + ry * (hy + n_lobes * wy)) * inverse_ez;
            step += ahead / larger(slope, 0.3 * flat);
            step = smaller(larger(step, -largest), largest);
        }
        feet[STEP + j] = step;
    }
}

static size_t add_edge(
    int w, double *restrict edges, size_t n, const Wheel *wheel, double cs, double sn, double nx, double ny,
    double point_x, double point_y, double line_x, double line_y, double line_at, double beside, double radius,
    double span, double turn, double weight, size_t j, double pin_x, double pin_y, double lever_x,
    double lever_y, double reach)
{
    double lx = cs * lever_x + sn * lever_y, ly = cs * lever_y - sn * lever_x;
    double v = (lx - point_x) * nx + (ly - point_y) * ny;
    double u = smaller((ly - point_y) * nx - (lx - point_x) * ny, beside);
    if (!(sqrt(v * v + u * u) < wheel->pin_radius + reach) || v < -reach)
        return n;
    double fx = cs * nx - sn * ny, fy = sn * nx + cs * ny;
    size_t k = w * EDGE_SIZE + n;
    edges[E_NX + k] = fx;
    edges[E_NY + k] = fy;
    edges[E_ALONG_N + k] = pin_x * fx + pin_y * fy;
    edges[E_ALONG_T + k] = pin_y * fx - pin_x * fy;
    edges[E_V + k] = point_x * nx + point_y * ny;
    edges[E_U + k] = point_y * nx - point_x * ny;
    edges[E_BESIDE + k] = beside;
    edges[E_LINE + k] = point_x * line_x + point_y * line_y - line_at;
    edges[E_LINE_V + k] = nx * line_x + ny * line_y;
    edges[E_LINE_U + k] = nx * line_y - ny * line_x;
    edges[E_RADIUS + k] = radius;
    edges[E_RADIUS_SPAN + k] = span;
    edges[E_TURN + k] = turn;
    edges[E_WEIGHT + k] = weight;
    edges[E_PIN + k] = (double)j;
    return n + 1;
}

INLINE ptrdiff_t lobe_number(double whole, ptrdiff_t n_lobes)
{
    ptrdiff_t lobe = (ptrdiff_t)whole % n_lobes;
    return lobe < 0 ? lobe + n_lobes : lobe;
}

INLINE Turn lobe_direction(
    const double *lobes, int w, ptrdiff_t lobe, double cos_theta, double sin_theta)
{
    double error = lobes[PITCH_ERROR + w * COLUMNS + lobe];
    double c = lobes[LOBE_COS + lobe], s = lobes[LOBE_SIN + lobe];
    double cl = c - error * s, sl = s + error * c;
    return (Turn){sin_theta * cl + cos_theta * sl, cos_theta * cl - sin_theta * sl};
}

static size_t describe_edges(
    int w, Machine *machine, double theta, double cos_theta, double sin_theta, double cx, double cy,
    double run_x, double run_y, double displaced)
{
    const Wheel *wheel = &machine->wheel;
    const double *pins = machine->pins, *lobes = machine->lobes;
    ptrdiff_t n_lobes = (ptrdiff_t)wheel->n_lobes;
    const double *wear = machine->wear + w * COLUMNS;
    double *edges = machine->edges;
    double pitch = 2.0 * M_PI / (double)n_lobes;
    double reach = EDGE_REACH * wheel->pin_circle_radius + DISPLACED_REACH * displaced;
    double q = wheel->pin_radius, tip = wheel->tip_x;
    double length = sqrt((wheel->pit_x - tip) * (wheel->pit_x - tip) + wheel->pit_y * wheel->pit_y);
    double ox = wheel->pit_y / length, oy = (tip - wheel->pit_x) / length;
    size_t n = 0;
    for (size_t j = 0; j < (size_t)n_lobes + 1; j++) {
        double place = (pins[PIN_ANGLE + j] - theta) / pitch;
        if (!(fabs(place) < 1e9))
            return n;
        double whole = floor(place + LEAD);
        double part = place - whole;
        ptrdiff_t worn_lobe = lobe_number(whole, n_lobes);
        double share = wear[worn_lobe];
        ptrdiff_t tip_lobe = lobe_number(floor(place + 0.5), n_lobes);
        int removed_ahead = wear[tip_lobe] == REMOVED;
        int removed_behind = wear[(tip_lobe + n_lobes - 1) % n_lobes] == REMOVED;
        int at_edge = removed_ahead != removed_behind;
        int on_chord = 0.0 < share && share <= 1.0 && part <= CHORD_ENDS;
        if (!(at_edge || on_chord))
            continue;
        double cb = pins[PIN_COS + j], sb = pins[PIN_SIN + j];
        double radial = wheel->pin_circle_radius + pins[PIN_RADIAL_ERROR + j];
        double tangential = pins[PIN_TANGENTIAL_ERROR + j];
        double pin_x = cb * radial - sb * tangential, pin_y = sb * radial + cb * tangential;
        double lever_x = pin_x - cx, lever_y = pin_y - cy;
        if (at_edge) {
            Turn to = lobe_direction(lobes, w, tip_lobe, cos_theta, sin_theta);
            double hx = to.cosine * run_x + to.sine * run_y, hy = to.cosine * run_y - to.sine * run_x;
            double side = removed_ahead ? 1.0 : -1.0;
            n = add_edge(w, edges, n, wheel, to.cosine, to.sine, 1.0, 0.0, hx + tip, hy, 0.0, side, side * hy,
                INFINITY, wheel->tip_radius, 0.0, 0.0, 1.0, j, pin_x, pin_y, lever_x, lever_y, reach);
        }
        if (on_chord) {
            Turn to = lobe_direction(lobes, w, worn_lobe, cos_theta, sin_theta);
            double hx = to.cosine * run_x + to.sine * run_y, hy = to.cosine * run_y - to.sine * run_x;
            n = add_edge(w, edges, n, wheel, to.cosine, to.sine, ox, oy, hx + tip, hy, 0.0, 1.0, hy, 0.0,
                wheel->tip_radius, q - wheel->tip_radius, ox / oy, share, j, pin_x, pin_y, lever_x, lever_y,
                reach);
            double line_x = wheel->pit_ny, line_y = -wheel->pit_nx;
            double pit_x = hx + wheel->pit_x, pit_y = hy + wheel->pit_y;
            n = add_edge(w, edges, n, wheel, to.cosine, to.sine, wheel->pit_nx, wheel->pit_ny, pit_x, pit_y,
                line_x, line_y, pit_x * line_x + pit_y * line_y, INFINITY, wheel->pit_radius, 0.0, 0.0, share,
                j, pin_x, pin_y, lever_x, lever_y, reach);
        }
    }
    return n;
}

static __attribute__((noinline)) void describe(
    int w, Machine *machine, double phi, double eps, double cos_theta, double sin_theta, double cx, double cy,
    Turn to_lobe)
{
    const Wheel *wheel = &machine->wheel;
    const double *restrict pins = machine->pins;
    const double *restrict mounts = machine->mounts + COLUMNS * w;
    const double *lobes = machine->lobes;
    double *restrict feet = machine->feet, *restrict flanks = machine->flanks, *restrict edges = machine->edges;
    double *seen = machine->seen[w];
    ptrdiff_t n_lobes = (ptrdiff_t)wheel->n_lobes;
    const double *wear = machine->wear + w * COLUMNS;
    double e = wheel->eccentricity, inverse_m = 1.0 / wheel->shortening, z = wheel->n_lobes;
    double n_pins = z + 1.0, q = wheel->pin_radius, big_r = wheel->pin_circle_radius;
    double inverse_ez = 1.0 / (e * n_pins), pitch = 2.0 * M_PI / z;
    double lobe_cos = to_lobe.cosine, lobe_sin = to_lobe.sine;
    double theta = eps - phi / z + mounts[REST_ANGLE];
    double run_x = cos_theta * mounts[RUNOUT_X] - sin_theta * mounts[RUNOUT_Y];
    double run_y = sin_theta * mounts[RUNOUT_X] + cos_theta * mounts[RUNOUT_Y];
    double offset_x = -(cx + e * lobe_cos) - run_x, offset_y = -(cy + e * lobe_sin) - run_y;
    double displaced = sqrt(offset_x * offset_x + offset_y * offset_y);
    int has_faults = mounts[HAS_FAULTS] != 0.0;
    double reach = FLANK_REACH * big_r + DISPLACED_REACH * displaced;
    size_t pin_count = (size_t)n_lobes + 1;
    for (size_t j = 0; j < pin_count; j++) {
        double cb = pins[PIN_COS + j], sb = pins[PIN_SIN + j];
        feet[DISPLACED_X + j] = cb * offset_x + sb * offset_y + pins[PIN_RADIAL_ERROR + j];
        feet[DISPLACED_Y + j] = cb * offset_y - sb * offset_x + pins[PIN_TANGENTIAL_ERROR + j];
        feet[TURNED + j] = 0.0;
        feet[TURNED_SLOPE + j] = 0.0;
    }
    newton_feet(wheel, pins, feet, to_lobe);
    double curve_1 = inverse_ez * (1.0 + 0.5 * z);
    double curve_3 = inverse_ez * 0.5 * z * (1.0 - inverse_m * inverse_m);
    double steepness = z * inverse_m * inverse_ez;
    size_t first = w * FLANK_SIZE, n = first;
    for (size_t j = 0; j < pin_count; j++) {
        double cb = pins[PIN_COS + j], sb = pins[PIN_SIN + j];
        double dx = feet[DISPLACED_X + j], dy = feet[DISPLACED_Y + j];
        double qx = cb * lobe_cos + sb * lobe_sin, qy = cb * lobe_sin - sb * lobe_cos;
        double step = feet[STEP + j];
        Turn one = small_sincos(step), two = small_sincos(n_pins * step);
        double wx = two.cosine * qx - two.sine * qy, wy = two.cosine * qy + two.sine * qx;
        double rx = dx + big_r * (1.0 - one.cosine) + e * (qx - wx);
        double ry = dy - big_r * one.sine + e * (qy - wy);
        double hx = one.cosine * inverse_m + wx, hy = one.sine * inverse_m + wy;
        double ig = 1.0 / sqrt(hx * hx + hy * hy);
        double nx = hx * ig, ny = hy * ig;
        double distance = rx * nx + ry * ny;
        double gap = distance + wheel->clearance;
        double place = (pins[PIN_ANGLE + j] - theta + step) / pitch;
        ptrdiff_t lobe = 0;
        double part = 0.0;
        if (fabs(place) < 1e9) {
            double whole = floor(place);
            part = place - whole;
            lobe = lobe_number(whole, n_lobes);
        }
        double cubic = curve_3 * ig * ig;
        double kappa = (curve_1 + cubic) * ig;
        double sine_lobe = one.cosine * hy - one.sine * hx;
        double cosine_lobe = one.cosine * hx + one.sine * hy - inverse_m;
        double change = (curve_1 + 3.0 * cubic) * (ig * ig) * (ig * ig) * steepness * sine_lobe;
        double ig_7 = (ig * ig) * (ig * ig) * (ig * ig) * ig;
        double second = (4.0 * curve_1 + 18.0 * cubic) * (steepness * sine_lobe) * (steepness * sine_lobe) * ig_7;
        second += (curve_1 + 3.0 * cubic) * (ig * ig) * (ig * ig) * steepness * z * cosine_lobe * inverse_ez * ig;
        if (!(gap < reach))
            continue;
        double before = 1.0, beyond = 1.0, line_value = 1.0, line_x = 0.0, line_y = 0.0;
        double lever_x = big_r + pins[PIN_RADIAL_ERROR + j] - (cb * cx + sb * cy);
        double lever_y = pins[PIN_TANGENTIAL_ERROR + j] - (cb * cy - sb * cx);
        if (has_faults) {
            double share = wear[lobe];
            if (share == REMOVED && 0.25 <= part && part < 0.75)
                continue;
            ptrdiff_t ahead = lobe;
            if (part >= 0.75)
                ahead = (lobe + 1) % n_lobes;
            double direction_x = 0.0, direction_y = 1.0, point_x = 0.0, point_y = 0.0;
            if (0.25 <= part && part < 0.75) {
                before = 1.0 - share;
                direction_x = -wheel->pit_ny;
                direction_y = wheel->pit_nx;
                point_x = wheel->pit_x;
                point_y = wheel->pit_y;
            } else {
                before = wear[(ahead + n_lobes - 1) % n_lobes] == REMOVED ? 0.0 : 1.0;
                beyond = wear[ahead] == REMOVED ? 0.0 : 1.0 - wear[ahead];
            }
            if (before == 0.0 && beyond == 0.0)
                continue;
            Turn to = lobe_direction(lobes, w, ahead, cos_theta, sin_theta);
            double cl = cb * to.cosine + sb * to.sine, sl = cb * to.sine - sb * to.cosine;
            line_x = cl * direction_x - sl * direction_y;
            line_y = sl * direction_x + cl * direction_y;
            double middle_x = cb * run_x + sb * run_y, middle_y = cb * run_y - sb * run_x;
            line_value = (lever_x - middle_x) * line_x + (lever_y - middle_y) * line_y
                         - (point_x * direction_x + point_y * direction_y);
        }
        double shallow = 1.0 / (1.0 - kappa * wheel->clearance);
        double radius = q * (1.0 - kappa * (q + wheel->clearance)) * shallow;
        double slack = larger(1.0 + kappa * distance, 0.3);
        double bend = kappa / slack;
        double third = change / (6.0 * slack * slack * slack);
        double radius_slope = -q * q * shallow * shallow * change / slack;
        second += change * change * (2.0 * wheel->clearance * shallow - distance / slack);
        double radius_bend = -0.5 * q * q * shallow * shallow * second / (slack * slack);
        double foot_u = ry * nx - rx * ny;
        double error = feet[TURNED + j];
        double turned_nx = nx - error * ny;
        ny = ny + error * nx;
        nx = turned_nx;
        double foot_x = lever_x - rx - (cb * run_x + sb * run_y);
        double foot_y = lever_y - ry - (cb * run_y - sb * run_x);
        double slope = -feet[TURNED_SLOPE + j] * inverse_ez * ig * (foot_x * ny - foot_y * nx);
        double across_v = lever_x * nx + lever_y * ny, across_u = lever_y * nx - lever_x * ny;
        double along_x = big_r + pins[PIN_RADIAL_ERROR + j], along_y = pins[PIN_TANGENTIAL_ERROR + j];
        double line_u = line_y * nx - line_x * ny;
        flanks[F_NX + n] = cb * nx - sb * ny;
        flanks[F_NY + n] = sb * nx + cb * ny;
        flanks[F_ALONG_N + n] = along_x * nx + along_y * ny;
        flanks[F_ALONG_T + n] = along_y * nx - along_x * ny;
        flanks[F_V + n] = across_v;
        flanks[F_U + n] = across_u - foot_u;
        flanks[F_GAP + n] = gap;
        flanks[F_SLOPE + n] = slope;
        flanks[F_BEND + n] = bend;
        flanks[F_CHANGE + n] = third;
        flanks[F_RADIUS + n] = radius;
        flanks[F_RADIUS_SLOPE + n] = radius_slope;
        flanks[F_RADIUS_BEND + n] = radius_bend;
        flanks[F_LINE_V + n] = line_x * nx + line_y * ny;
        flanks[F_LINE_U + n] = line_u;
        flanks[F_LINE + n] = line_value - foot_u * line_u;
        flanks[F_BEFORE + n] = before;
        flanks[F_BEYOND + n] = beyond;
        flanks[F_PIN + n] = (double)j;
        n++;
    }
    size_t used = n - first;
    while ((n - first) % BLOCK != 0) {
        for (size_t row = 0; row < FLANK_ROWS; row++)
            flanks[row * COLUMNS + n] = 0.0;
        flanks[F_GAP + n] = 1.0;
        n++;
    }
    size_t n_edges = 0;
    if (has_faults)
        n_edges = describe_edges(w, machine, theta, cos_theta, sin_theta, cx, cy, run_x, run_y, displaced);
    size_t padded = n_edges;
    while (padded % BLOCK != 0) {
        size_t k = w * EDGE_SIZE + padded;
        for (size_t row = 0; row < EDGE_ROWS; row++)
            edges[row * EDGE_COLUMNS + k] = 0.0;
        edges[E_V + k] = -2.0 * big_r - 1.0;
        padded++;
    }
    seen[SEEN_PHI] = phi;
    seen[SEEN_EPS] = eps;
    seen[SEEN_CELL] = cell(phi);
    machine->counts[w][N_FLANKS] = n - first;
    machine->counts[w][N_EDGES] = padded;
    machine->counts[w][USED_FLANKS] = used;
    machine->counts[w][USED_EDGES] = n_edges;
}

INLINE double contact_force(double penetration, double rate, double radius, const Contact *contact)
{
    if (contact->law == CONSERVATIVE_LAW)
        radius = contact->constant_radius;
    double depth = larger(penetration, 0.0);
    double rise = smaller(depth * contact->inverse_ramp, 1.0);
    double elastic = contact->stiffness_factor * rise * depth * sqrt(radius * depth);
    if (contact->law == HUNT_CROSSLEY_LAW)
        return larger(elastic * (1.0 + contact->damping * rate), 0.0);
    return larger(elastic + contact->damping * rise * rate, 0.0);
}

INLINE Load flank_contacts(
    size_t n, int has_faults, Contact contact, double *restrict flanks, double ct, double st, double cx,
    double cy, double omega, double rate)
{
    double on_cam = 0.0, on_pin = 0.0, swing = rate - omega;
#pragma GCC ivdep
    for (size_t k = 0; k < n; k++) {
        double nx = flanks[F_NX + k], ny = flanks[F_NY + k];
        double pin_n = ct * flanks[F_ALONG_N + k] + st * flanks[F_ALONG_T + k];
        double pin_t = ct * flanks[F_ALONG_T + k] - st * flanks[F_ALONG_N + k];
        double cam_n = cx * nx + cy * ny, cam_t = cy * nx - cx * ny;
        double v = pin_n - cam_n - flanks[F_V + k], u = pin_t - cam_t - flanks[F_U + k];
        double bend = flanks[F_BEND + k];
        bend = bend - bend * bend * v;
        double third = flanks[F_CHANGE + k], slope = flanks[F_SLOPE + k];
        double gap = flanks[F_GAP + k] + v + u * (slope + u * (0.5 * bend + third * u));
        double tilt = slope + u * (bend + 3.0 * third * u);
        double along = 1.0 - 0.5 * tilt * tilt;
        double cam_arm = cam_n * tilt - cam_t * along;
        double pin_arm = pin_n * tilt - pin_t * along;
        double penetration_rate = rate * pin_arm - swing * cam_arm;
        double radius_slope = flanks[F_RADIUS_SLOPE + k] + flanks[F_RADIUS_BEND + k] * u;
        double radius = larger(flanks[F_RADIUS + k] + radius_slope * u, 0.0);
        double f = contact_force(-gap, penetration_rate, radius, &contact);
        if (has_faults) {
            double line = flanks[F_LINE + k] + flanks[F_LINE_V + k] * v + flanks[F_LINE_U + k] * u;
            double before = flanks[F_BEFORE + k], beyond = flanks[F_BEYOND + k];
            f *= line >= 0.0 ? beyond : before;
        }
        flanks[F_FORCE + k] = f;
        flanks[F_TILT + k] = tilt;
        on_cam += f * cam_arm;
        on_pin += f * pin_arm;
    }
    return (Load){-on_cam, on_cam - on_pin, 0.0};
}

INLINE Load edge_contacts(
    size_t n, Contact contact, double *restrict edges, double pin_radius, double ct, double st, double cx,
    double cy, double omega, double rate)
{
    double on_cam = 0.0, on_pin = 0.0, swing = rate - omega;
#pragma GCC ivdep
    for (size_t k = 0; k < n; k++) {
        double nx = edges[E_NX + k], ny = edges[E_NY + k];
        double pin_n = ct * edges[E_ALONG_N + k] + st * edges[E_ALONG_T + k];
        double pin_t = ct * edges[E_ALONG_T + k] - st * edges[E_ALONG_N + k];
        double cam_n = cx * nx + cy * ny, cam_t = cy * nx - cx * ny;
        double v = pin_n - cam_n - edges[E_V + k], u = pin_t - cam_t - edges[E_U + k];
        double line = edges[E_LINE + k] + edges[E_LINE_V + k] * v + edges[E_LINE_U + k] * u;
        double beside = smaller(u, edges[E_BESIDE + k]);
        double square = v * v + beside * beside;
        double distance = sqrt(square);
        double inverse = distance * (1.0 / square);
        double along = v * inverse, tilt = beside * inverse;
        double cam_arm = cam_n * tilt - cam_t * along;
        double pin_arm = pin_n * tilt - pin_t * along;
        double penetration_rate = rate * pin_arm - swing * cam_arm;
        double turned = smaller(larger(along + edges[E_TURN + k] * tilt, 0.0), 1.0);
        double radius = edges[E_RADIUS + k] + turned * edges[E_RADIUS_SPAN + k];
        /* 1 or 0 by the sign of line: a conditional would make gcc branch and not vectorise. */
        double weight = edges[E_WEIGHT + k] * (0.5 + copysign(0.5, line));
        double f = weight * contact_force(pin_radius - distance, penetration_rate, radius, &contact);
        edges[E_FORCE + k] = f;
        edges[E_ALONG + k] = along;
        edges[E_TILT + k] = tilt;
        on_cam += f * cam_arm;
        on_pin += f * pin_arm;
    }
    return (Load){-on_cam, on_cam - on_pin, 0.0};
}

INLINE Load joint_contacts(
    Joint joint, Contact contact, const double *restrict sleeves, double *restrict carried, double cx, double cy,
    double omega, Turn out, Turn hole, double rate_out, double rate)
{
    double r = joint.pitch_radius;
    double hx = r * hole.cosine, hy = r * hole.sine;
    double sx = r * (out.cosine - hole.cosine), sy = r * (out.sine - hole.sine);
    double hole_c = hx * cy - hy * cx, hole_s = -(hy * cy + hx * cx);
    double way_c = sx * cy - sy * cx, way_s = -(sy * cy + sx * cx);
    double out_c = hole_c + way_c, out_s = hole_s + way_s;
    double lever = hx * sy - hy * sx;
    double square_0 = sx * sx + sy * sy + cx * cx + cy * cy;
    double square_c = 2.0 * way_s, square_s = -2.0 * way_c;
    double rate_0 = (rate_out - rate) * lever;
    double rate_c = rate * hole_c - rate_out * out_c + omega * way_c;
    double rate_s = rate * hole_s - rate_out * out_s + omega * way_s;
    double sum_0 = 0.0, sum_c = 0.0, sum_s = 0.0;
    size_t n = (size_t)joint.n_sleeves;
#pragma GCC ivdep
    for (size_t k = 0; k < n; k++) {
        double ca = sleeves[SLEEVE_COS + k], sa = sleeves[SLEEVE_SIN + k];
        double square = square_0 + ca * square_c + sa * square_s;
        double distance = sqrt(square);
        double inverse = distance * (1.0 / square);
        double penetration_rate = (rate_0 + ca * rate_c + sa * rate_s) * inverse;
        double f = contact_force(
            distance - joint.gap_at_centre, penetration_rate, contact.constant_radius, &contact);
        carried[S_FORCE + k] = f;
        double over = f * inverse;
        sum_0 += over;
        sum_c += over * ca;
        sum_s += over * sa;
    }
    return (Load){-(sum_c * way_c + sum_s * way_s), lever * sum_0 - (hole_c * sum_c + hole_s * sum_s),
        out_c * sum_c + out_s * sum_s - lever * sum_0};
}

INLINE void derivatives(
    double phi, Turn fast, Turn slow, double omega, double alpha, double load, const double *restrict state,
    Machine *restrict machine, double *restrict rates, double *restrict result)
{
    const Wheel *wheel = &machine->wheel;
    const Body *body = &machine->body;
    double z = wheel->n_lobes;
    double mean_rate = -omega / z, mean_acceleration = -alpha / z;
    Turn by = small_sincos(state[2]);
    Turn out = {slow.sine * by.cosine + slow.cosine * by.sine, slow.cosine * by.cosine - slow.sine * by.sine};
    double rate_out = mean_rate + state[6];
    double moment_out = 0.0, torque_in = 0.0;
    for (int w = 0; w < 2; w++) {
        const double *mounts = machine->mounts + COLUMNS * w;
        double side = 1.0 - 2.0 * w, eps = state[w];
        double cx = mounts[CAM_X] * fast.cosine - mounts[CAM_Y] * fast.sine;
        double cy = mounts[CAM_X] * fast.sine + mounts[CAM_Y] * fast.cosine;
        double rate = mean_rate + state[4 + w];
        by = small_sincos(eps);
        Turn hole = {
            slow.sine * by.cosine + slow.cosine * by.sine, slow.cosine * by.cosine - slow.sine * by.sine};
        if (moved_on(machine->seen[w], phi, eps)) {
            Turn lobe = small_sincos(z * eps);
            describe(w, machine, phi, eps, hole.cosine * mounts[REST_COS] - hole.sine * mounts[REST_SIN],
                hole.sine * mounts[REST_COS] + hole.cosine * mounts[REST_SIN], cx, cy,
                (Turn){-side * (fast.sine * lobe.cosine - fast.cosine * lobe.sine),
                    -side * (fast.cosine * lobe.cosine + fast.sine * lobe.sine)});
        }
        Turn now = small_sincos(eps - machine->seen[w][SEEN_EPS] - (phi - machine->seen[w][SEEN_PHI]) / z);
        double ct = now.cosine, st = now.sine;
        double own_cx = ct * cx + st * cy, own_cy = ct * cy - st * cx;
        double *flanks = machine->flanks + w * FLANK_SIZE;
        size_t n_flanks = machine->counts[w][N_FLANKS], n_edges = machine->counts[w][N_EDGES];
        Load own;
        if (mounts[HAS_FAULTS] != 0.0)
            own = flank_contacts(n_flanks, 1, machine->contact, flanks, ct, st, own_cx, own_cy, omega, rate);
        else
            own = flank_contacts(n_flanks, 0, machine->contact, flanks, ct, st, own_cx, own_cy, omega, rate);
        if (n_edges > 0) {
            Load edge = edge_contacts(n_edges, machine->contact, machine->edges + w * EDGE_SIZE,
                wheel->pin_radius, ct, st, own_cx, own_cy, omega, rate);
            own.on_cam += edge.on_cam;
            own.moment += edge.moment;
        }
        Load joint = joint_contacts(machine->joint, machine->joint_contact, machine->sleeves,
            machine->on_sleeves + w * JOINT_SIZE, cx, cy, omega, out, hole, rate_out, rate);
        moment_out += joint.moment_out;
        rates[w] = state[4 + w];
        rates[4 + w] = (own.moment + joint.moment) / body->wheel_inertia - mean_acceleration;
        torque_in += body->wheel_mass * alpha * (cx * cx + cy * cy) - own.on_cam - joint.on_cam;
    }
    rates[2] = state[6];
    rates[3] = state[7];
    if (body->brake_inertia > 0.0) {
        double meter =
            body->meter_stiffness * (state[3] - state[2]) + body->meter_damping * (state[7] - state[6]);
        rates[6] = (moment_out + meter) / body->output_inertia - mean_acceleration;
        rates[7] = (load - meter) / body->brake_inertia - mean_acceleration;
        result[0] = meter;
    } else {
        rates[6] = (moment_out + load) / body->output_inertia - mean_acceleration;
        rates[7] = 0.0;
        result[0] = -moment_out;
    }
    result[1] = torque_in;
}

INLINE Turn turned(Turn from, double angle)
{
    Turn by = small_sincos(angle);
    double x = from.cosine * by.cosine - from.sine * by.sine;
    double y = from.sine * by.cosine + from.cosine * by.sine;
    double scale = 1.5 - 0.5 * (x * x + y * y);
    return (Turn){y * scale, x * scale};
}

/* Returns the number of finished steps. result is (n_steps, 2). */
ptrdiff_t integrate(
    ptrdiff_t n_steps, double dt, const double *phi, const double *omega, const double *alpha,
    const double *load, double *state, const Wheel *wheel, const Joint *joint, const Contact *contact,
    const Contact *joint_contact, const Body *body, const double *pins, const double *mounts,
    const double *lobes, const double *wear, const double *sleeves, double limit, double locked_torque,
    double locked_steps, double *result)
{
    Machine machine = {.wheel = *wheel, .joint = *joint, .contact = *contact,
        .joint_contact = *joint_contact, .body = *body, .pins = pins, .mounts = mounts, .lobes = lobes,
        .wear = wear, .sleeves = sleeves};
    for (int k = 0; k < 3; k++)
        machine.seen[0][k] = machine.seen[1][k] = INFINITY;
    double z = wheel->n_lobes, rates[N_STATE], middle[N_STATE], scratch[2];
    Turn fast = {0.0, 1.0}, slow = {0.0, 1.0};
    double locked = 0;
    for (ptrdiff_t step = 0; step < n_steps; step++) {
        ptrdiff_t i = 2 * step;
        if (step % RESYNC == 0) {
            fast = (Turn){sin(phi[i]), cos(phi[i])};
            slow = (Turn){-sin(phi[i] / z), cos(phi[i] / z)};
        } else {
            double turn = phi[i] - phi[i - 1];
            fast = turned(fast, turn);
            slow = turned(slow, -turn / z);
        }
        double *now = result + 2 * step;
        derivatives(phi[i], fast, slow, omega[i], alpha[i], load[i], state, &machine, rates, now);
        locked = fabs(now[1]) > locked_torque ? locked + 1 : 0;
        if (locked > locked_steps || !(fabs(now[0]) < limit && fabs(now[1]) < limit))
            return step;
        for (int k = 0; k < N_STATE; k++)
            middle[k] = state[k] + 0.5 * dt * rates[k];
        double turn = phi[i + 1] - phi[i];
        fast = turned(fast, turn);
        slow = turned(slow, -turn / z);
        derivatives(
            phi[i + 1], fast, slow, omega[i + 1], alpha[i + 1], load[i + 1], middle, &machine, rates, scratch);
        for (int k = 0; k < N_STATE; k++)
            state[k] += dt * rates[k];
    }
    return n_steps;
}
