/* Elementary functions in single precision. Each section is copied into exported code that needs it.

   Errors are below 2e-7, relative or (near zeros of sine and cosine) absolute; the reduction of sine and cosine
   is exact for arguments up to 2e4. Constants of the reductions, of the arctangent and of the logarithm are
   those of Cephes (S. Moshier, 1989). */

/* = rounded */
static float NAME_rounded(float x)
{
    const float near = (x + 12582912.0f) - 12582912.0f;
    return fabsf(x) < 4194304.0f ? near : x;
}

/* = floor rounded */
static float NAME_floor(float x)
{
    const float near = NAME_rounded(x);
    return near > x ? near - 1.0f : near;
}

/* = turned rounded */
static float NAME_turned(float x, float *rest)
{
    const float k = NAME_rounded(x * 0.318309886f);
    *rest = ((x - k * 3.140625f) - k * 9.67502594e-4f) - k * 1.50995799e-7f;
    return k - 2.0f * NAME_rounded(0.5f * k);
}

/* = sin turned */
static float NAME_sin(float x)
{
    float r;
    const float odd = NAME_turned(x, &r), z = r * r;
    const float high = (-2.50521084e-8f + 1.60590438e-10f * z) * z + 2.75573192e-6f;
    const float found = r + r * z * (((high * z - 1.98412698e-4f) * z + 8.33333333e-3f) * z - 0.166666667f);
    return odd < 0.0f || odd > 0.0f ? -found : found;
}

/* = cos turned */
static float NAME_cos(float x)
{
    float r;
    const float odd = NAME_turned(x, &r), z = r * r;
    const float high = ((-1.14707456e-11f * z + 2.08767570e-9f) * z - 2.75573192e-7f) * z + 2.48015873e-5f;
    const float found = 1.0f + z * (((high * z - 1.38888889e-3f) * z + 4.16666667e-2f) * z - 0.5f);
    return odd < 0.0f || odd > 0.0f ? -found : found;
}

/* = exp rounded */
static float NAME_exp(float x)
{
    union { float real; uint32_t bits; } power;
    const float inside = x > -87.0f ? (x < 88.7f ? x : 88.7f) : -87.0f;
    const float k = NAME_rounded(inside * 1.44269504f);
    const float r = (inside - k * 0.693359375f) + k * 2.12194440e-4f;
    const float high = ((1.98412698e-4f * r + 1.38888889e-3f) * r + 8.33333333e-3f) * r + 4.16666667e-2f;
    power.bits = (uint32_t)((int32_t)k + 126) << 23;
    if (!(x <= 88.7f)) {
        return x > 88.7f ? INFINITY : x;
    }
    return x < -87.0f ? 0.0f : ((((high * r + 0.166666667f) * r + 0.5f) * r + 1.0f) * r + 1.0f) * power.real * 2.0f;
}

/* = expm1 exp */
static float NAME_expm1(float x)
{
    const float high = ((2.48015873e-5f * x + 1.98412698e-4f) * x + 1.38888889e-3f) * x + 8.33333333e-3f;
    const float small = (((high * x + 4.16666667e-2f) * x + 0.166666667f) * x + 0.5f) * x * x + x;
    return fabsf(x) < 0.5f ? small : NAME_exp(x) - 1.0f;
}

/* = tanh expm1 */
static float NAME_tanh(float x)
{
    const float grown = NAME_expm1(fabsf(x) < 20.0f ? 2.0f * fabsf(x) : 40.0f);
    const float size = grown / (grown + 2.0f);
    return x < 0.0f ? -size : (x == x ? size : x);
}

/* = log */
static float NAME_log(float x)
{
    union { float real; uint32_t bits; } word;
    const int tiny = x < 1.17549435e-38f;
    word.real = tiny ? x * 33554432.0f : x;
    const int32_t high = (int32_t)(word.bits & 0x7fffffu) > 0x3504f3;
    const float exponent = (float)((int32_t)(word.bits >> 23) - 127 + high) - (tiny ? 25.0f : 0.0f);
    word.bits = (word.bits & 0x7fffffu) | (high ? 0x3f000000u : 0x3f800000u);
    const float f = word.real - 1.0f, s = f / (2.0f + f), z = s * s;
    const float series = ((0.222222222f * z + 0.285714286f) * z + 0.4f) * z + 0.666666667f;
    if (!(x > 0.0f) || x > 3.40282347e+38f) {
        return x < 0.0f || !(x == x) ? NAN : (x > 0.0f ? x : -INFINITY);
    }
    return exponent * 0.693359375f + (2.0f * s + (s * z * series - exponent * 2.12194440e-4f));
}

/* = log1p log */
static float NAME_log1p(float x)
{
    const float sum = 1.0f + x;
    return sum == 1.0f ? x : NAME_log(sum) * (x / (sum - 1.0f));
}

/* = angle */
static float NAME_angle(float y, float x)
{
    const int steep = y > 2.41421356f * x, middle = y > 0.414213562f * x;
    const float top = steep ? -x : (middle ? y - x : y), bottom = steep ? y : (middle ? y + x : x);
    const float t = bottom > 0.0f ? top / bottom : 0.0f, z = t * t;
    const float series = ((8.05374450e-2f * z - 0.138776856f) * z + 0.199777106f) * z - 0.333329492f;
    return (steep ? 1.57079633f : (middle ? 0.785398163f : 0.0f)) + (t + t * z * series);
}

/* = arctan angle */
static float NAME_arctan(float x)
{
    const float found = NAME_angle(fabsf(x), 1.0f);
    return x < 0.0f ? -found : found;
}

/* = arctan2 angle */
static float NAME_arctan2(float y, float x)
{
    const float size = NAME_angle(fabsf(y), fabsf(x)), found = x < 0.0f ? 3.14159265f - size : size;
    return y < 0.0f ? -found : found;
}
