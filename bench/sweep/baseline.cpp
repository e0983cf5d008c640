// The ten scores in double precision, timed: the insecure baseline. See bench/sweep/baseline.py.
//
//   baseline SCORE N TRIALS < pairs
//
// reads TRIALS pairs of N doubles and N doubles, and prints for each the score and the seconds of one evaluation:
// the mean over as many repetitions as fill a millisecond.

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

using Score = double (*)(const double *, const double *, int);

static double dot(const double *x, const double *y, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += x[i] * y[i];
    return sum;
}

static double l1_norm(const double *x, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += std::fabs(x[i]);
    return sum;
}

// The distances of x / a and y / b.
static double l1(const double *x, const double *y, int n, double a, double b) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += std::fabs(x[i] / a - y[i] / b);
    return sum;
}

static double l2sq(const double *x, const double *y, int n, double a, double b) {
    double sum = 0;
    for (int i = 0; i < n; i++) {
        double difference = x[i] / a - y[i] / b;
        sum += difference * difference;
    }
    return sum;
}

static double l2_norm(const double *x, int n) { return std::sqrt(dot(x, x, n)); }

static double s1(const double *x, const double *y, int n) { return l1(x, y, n, l1_norm(x, n), l1_norm(y, n)); }

static double s2(const double *x, const double *y, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += std::fabs(x[i] - y[i]);
    return sum;
}

static double s5(const double *x, const double *y, int n) { return l2sq(x, y, n, l2_norm(x, n), l2_norm(y, n)); }

static double s3(const double *x, const double *y, int n) { return std::sqrt(s5(x, y, n)); }

static double s6(const double *x, const double *y, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += (x[i] - y[i]) * (x[i] - y[i]);
    return sum;
}

static double s4(const double *x, const double *y, int n) { return std::sqrt(s6(x, y, n)); }

static double s7(const double *x, const double *y, int n) {
    double a = l2_norm(x, n), b = l2_norm(y, n), sum = 0;
    for (int i = 0; i < n; i++) sum += (x[i] / a) * (y[i] / b);
    return sum;
}

static double s8(const double *x, const double *y, int n) { return dot(x, y, n) / (l2_norm(x, n) * l2_norm(y, n)); }

static double s9(const double *x, const double *y, int n) {
    return dot(x, y, n) / std::sqrt(dot(x, x, n) * dot(y, y, n));
}

// The compiler must take it that anything may have read and written the vectors, so no evaluation is left out.
static void forget(const void *where) { asm volatile("" : : "g"(where) : "memory"); }

static double seconds_of(Score score, const double *x, const double *y, int n, long repetitions) {
    auto started = std::chrono::steady_clock::now();
    for (long k = 0; k < repetitions; k++) {
        forget(x);
        forget(y);
        volatile double kept = score(x, y, n);
        (void)kept;
    }
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
}

int main(int count, char **words) {
    static const struct {
        const char *name;
        Score score;
    } scores[] = {{"S1", s1}, {"S2", s2}, {"S3", s3}, {"S4", s4}, {"S5", s5},
                  {"S6", s6}, {"S7", s7}, {"S8", s8}, {"S9", s9}, {"S10", dot}};
    Score score = nullptr;
    for (auto &entry : scores)
        if (count == 4 && !std::strcmp(entry.name, words[1])) score = entry.score;
    if (!score) return 2;
    int n = std::atoi(words[2]), trials = std::atoi(words[3]);
    std::vector<double> x(n), y(n);
    long repetitions = 1;
    for (int trial = 0; trial < trials; trial++) {
        if (std::fread(x.data(), 8, n, stdin) != size_t(n) || std::fread(y.data(), 8, n, stdin) != size_t(n)) return 3;
        if (!trial)
            while (seconds_of(score, x.data(), y.data(), n, repetitions) < 1e-3) repetitions *= 2;
        double seconds = seconds_of(score, x.data(), y.data(), n, repetitions) / repetitions;
        std::printf("%.17g %.9g\n", score(x.data(), y.data(), n), seconds);
    }
}
