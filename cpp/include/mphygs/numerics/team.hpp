// Threads that stay together over the many short loops of one run.
//
// A substep is a loop of tens of microseconds: to open a parallel region for each costs little while every
// thread has a core to itself, and most of the run where it has not, for each waits for the slowest. Here every
// thread has items of its own, the same ones every time, for what they work on lies in its cache; and who is
// done takes from the others, so that a thread that is not running holds nothing up.
#pragma once

#include <sched.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <thread>
#include <vector>

#include "mphygs/numerics/parallel.hpp"

namespace mphygs {

class Team {
  public:
    /// Calls f(i) for i in [0, count), on all threads of the team; every call has returned when it does.
    template <class F>
    void each(int count, const F& f) {
        if (threads_ <= 1 || count <= 1) {
            for (int i = 0; i < count; ++i) {
                f(i);
            }
            return;
        }
        job_ = &f;
        call_ = [](const void* job, int i) { (*static_cast<const F*>(job))(i); };
        left_.store(count, std::memory_order_relaxed);
        ++round_;
        for (int t = 0; t < threads_; ++t) {
            queues_[index(t)].ticket.store(round_ << 40 | static_cast<std::uint64_t>(count) << 20, std::memory_order_release);
        }
        for (int spins = 0; left_.load(std::memory_order_acquire) > 0;) {
            spins = take(0, spins >= polite) ? 0 : spins + 1;
            pause(spins);
        }
    }

    /// Runs body(team) on the calling thread while threads - 1 others help; what it throws comes back. The others
    /// are no OpenMP region's, so that a body may call what opens one of its own, a loss in torch, say.
    template <class F>
    static void run(int threads, F&& body) {
        Team team;
        if (threads <= 1) {
            body(team);
            return;
        }
        team.threads_ = threads;
        team.queues_ = std::make_unique<Queue[]>(index(threads));
        std::vector<std::jthread> others;
        const Over over{team.over_};  // also where a thread cannot be had, and before the others are joined
        for (int own = 1; own < threads; ++own) {
            others.emplace_back([&team, own] { team.help(own); });
        }
        body(team);
    }

  private:
    static constexpr std::uint64_t field = (1U << 20) - 1;
    // Pauses before a thread takes what is another's, which that one may be about to do, and before it lets
    // others than the team run.
    static constexpr int polite = 60, patience = 200;
    // And before it sleeps: the body is at something of its own.
    static constexpr int bored = 20000;

    /// Round, number of items of all threads, and next item of this one, in one word: who takes an item knows
    /// which round's it is.
    struct alignas(64) Queue {
        std::atomic<std::uint64_t> ticket{0};
    };

    struct Over {
        std::atomic<bool>& flag;
        ~Over() { flag.store(true, std::memory_order_release); }
    };

    void help(int own) {
        for (int spins = 0; !over_.load(std::memory_order_acquire);) {
            spins = take(own, spins >= polite) ? 0 : spins + 1;
            pause(spins);
        }
    }

    static std::size_t index(int t) { return static_cast<std::size_t>(t); }

    /// First item of thread t, of as many as a ticket says.
    std::uint64_t first(std::uint64_t ticket, int t) const { return part_begin(ticket >> 20 & field, threads_, t); }
    bool has_item(std::uint64_t ticket, int t) const { return first(ticket, t) + (ticket & field) < first(ticket, t + 1); }

    /// Does one item of the round, the thread's own first, if there is one left.
    bool take(int own, bool others) {
        for (int k = 0; k < (others ? threads_ : 1); ++k) {
            const int t = (own + k) % threads_;
            std::atomic<std::uint64_t>& ticket = queues_[index(t)].ticket;
            if (!has_item(ticket.load(std::memory_order_acquire), t)) {
                continue;
            }
            const std::uint64_t got = ticket.fetch_add(1, std::memory_order_acq_rel);
            if (has_item(got, t)) {
                call_(job_, static_cast<int>(first(got, t) + (got & field)));
                left_.fetch_sub(1, std::memory_order_acq_rel);
                return true;
            }
        }
        return false;
    }

    static void pause(int spins) {
        if (spins == 0) {
            return;
        }
        if (spins >= bored) {
            std::this_thread::sleep_for(std::chrono::microseconds(100));
            return;
        }
        if (spins >= patience) {
            sched_yield();
            return;
        }
#if defined(__x86_64__) || defined(__i386__)
        __builtin_ia32_pause();
#endif
    }

    const void* job_ = nullptr;
    void (*call_)(const void*, int) = nullptr;
    int threads_ = 1;
    std::uint64_t round_ = 0;
    std::unique_ptr<Queue[]> queues_;
    alignas(64) std::atomic<int> left_{0};
    alignas(64) std::atomic<bool> over_{false};
};

}  // namespace mphygs
